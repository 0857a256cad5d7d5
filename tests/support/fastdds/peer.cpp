// A ROS 2 node's middleware without ROS 2: Fast DDS with the default QoS of ROS subscriptions and
// publishers (reliable, volatile, keep last 10).
//
//     peer RANGE DOMAIN COUNT AFTER COMMAND
//
// RANGE is SUBNET (multicast) or LOCALHOST (unicast to this machine), as in
// ROS_AUTOMATIC_DISCOVERY_RANGE. Prints a JSON line for each of COUNT point clouds, and sends COMMAND on /phy124/command after the
// cloud AFTER. Leaves after 20 s without a cloud.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.hpp>
#include <fastdds/utils/IPLocator.hpp>

#include "messagesPubSubTypes.hpp"

using namespace eprosima::fastdds::dds;
using Cloud = sensor_msgs::msg::dds_::PointCloud2_;
using CloudType = sensor_msgs::msg::dds_::PointCloud2_PubSubType;
using Text = std_msgs::msg::dds_::String_;
using TextType = std_msgs::msg::dds_::String_PubSubType;

// The checksum of zlib.crc32.
uint32_t crc32(const std::vector<uint8_t>& data)
{
    uint32_t sum = ~0u;
    for (uint8_t byte : data) {
        sum ^= byte;
        for (int bit = 0; bit < 8; ++bit) sum = sum >> 1 ^ (sum & 1 ? 0xEDB88320u : 0u);
    }
    return ~sum;
}

void print(const Cloud& cloud)
{
    const auto& stamp = cloud.header().stamp();
    std::string fields;
    for (const auto& field : cloud.fields()) {
        fields += (fields.empty() ? "\"" : ", \"") + std::string(field.name()) + "\"";
    }
    std::printf("{\"stamp\": %lld, \"width\": %u, \"fields\": [%s], \"crc\": %u}\n",
        1000000000LL * stamp.sec() + stamp.nanosec(), cloud.width(), fields.c_str(),
        crc32(cloud.data()));
    std::fflush(stdout);
}

template <class Qos>
Qos ros_default(Qos qos)
{
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = VOLATILE_DURABILITY_QOS;
    qos.history().kind = KEEP_LAST_HISTORY_QOS;
    qos.history().depth = 10;
    qos.endpoint().history_memory_policy =
        eprosima::fastdds::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    qos.data_sharing().off();
    return qos;
}

// As rmw_fastrtps_cpp finds nodes of this machine.
DomainParticipantQos localhost()
{
    DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
    auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    udp->maxInitialPeersRange = 32;
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(udp);
    eprosima::fastdds::rtps::Locator_t here;
    eprosima::fastdds::rtps::IPLocator::setIPv4(here, 127, 0, 0, 1);
    qos.wire_protocol().builtin.initialPeersList.push_back(here);
    return qos;
}

int main(int, char** arguments)
{
    const bool far = std::string(arguments[1]) == "SUBNET";
    const int domain = std::atoi(arguments[2]), count = std::atoi(arguments[3]);
    const int after = std::atoi(arguments[4]);
    auto* participant = DomainParticipantFactory::get_instance()->create_participant(
        domain, far ? PARTICIPANT_QOS_DEFAULT : localhost());
    if (participant == nullptr) return 1;
    TypeSupport cloud_type(new CloudType()), text_type(new TextType());
    cloud_type.register_type(participant);
    text_type.register_type(participant);
    auto* points = participant->create_topic(
        "rt/phy124/points", cloud_type.get_type_name(), TOPIC_QOS_DEFAULT);
    auto* command = participant->create_topic(
        "rt/phy124/command", text_type.get_type_name(), TOPIC_QOS_DEFAULT);
    auto* reader = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)
                       ->create_datareader(points, ros_default(DATAREADER_QOS_DEFAULT));
    auto* writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)
                       ->create_datawriter(command, ros_default(DATAWRITER_QOS_DEFAULT));
    if (reader == nullptr || writer == nullptr) return 1;
    std::printf("{\"ready\": true}\n");
    std::fflush(stdout);
    Cloud cloud;
    SampleInfo info;
    for (int received = 0; received < count;) {
        if (!reader->wait_for_unread_message({20, 0})) break;
        while (reader->take_next_sample(&cloud, &info) == RETCODE_OK) {
            if (!info.valid_data) continue;
            print(cloud);
            if (++received == after) {
                Text text;
                text.data(arguments[5]);
                writer->write(&text);
            }
        }
    }
    writer->wait_for_acknowledgments({5, 0});
    participant->delete_contained_entities();
    DomainParticipantFactory::get_instance()->delete_participant(participant);
    return 0;
}
