"""A client of Foxglove's protocol, also as a process: `python -m support.foxglove_client`."""

import json
import struct
import sys

from support.websocket import BINARY, TEXT, WebSocket

MESSAGE_DATA, PLAYBACK_STATE, PLAYBACK_REQUEST = 1, 5, 3
CLIENT_DATA, SERVICE_REQUEST, SERVICE_RESPONSE = 1, 2, 3
NODE = "/phy124/live"


class Client(WebSocket):
    """A websocket client that can subscribe and move the playback controls."""

    def __init__(self, port):
        super().__init__(port, "/", "Sec-WebSocket-Protocol: foxglove.sdk.v1")
        self.channels, self.services = {}, {}
        self.info = self.text("serverInfo")

    def receive(self):
        """Return the next message: an object from text, or bytes."""
        kind, payload = self.frame()
        if kind != TEXT:
            return payload
        message = json.loads(payload)
        if message["op"] == "advertise":
            self.channels |= {channel["topic"]: channel for channel in message["channels"]}
        if message["op"] == "advertiseServices":
            self.services |= {service["name"]: service for service in message["services"]}
        return message

    def text(self, op):
        while True:
            message = self.receive()
            if isinstance(message, dict) and message["op"] == op:
                return message

    def binary(self, opcode):
        while True:
            message = self.receive()
            if isinstance(message, bytes) and message[0] == opcode:
                return message[1:]

    def subscribe(self, *topics):
        while not set(topics) <= self.channels.keys():
            self.receive()
        wanted = [{"id": i, "channelId": self.channels[t]["id"]} for i, t in enumerate(topics)]
        self.send(json.dumps({"op": "subscribe", "subscriptions": wanted}).encode())

    def control(self, playing, speed=1.0, seek=None, request="r1"):
        sought = struct.pack("<BQ", seek is not None, seek or 0)
        name = request.encode()
        body = struct.pack("<BBf", PLAYBACK_REQUEST, 0 if playing else 1, speed) + sought
        self.send(body + struct.pack("<I", len(name)) + name, kind=BINARY)

    def data(self):
        """Return subscription, log time and payload of the next message."""
        message = self.binary(MESSAGE_DATA)
        return *struct.unpack("<IQ", message[:12]), message[12:]

    def advertise(self, number, topic, schema, encoding="json"):
        channel = {"id": number, "topic": topic, "encoding": encoding, "schemaName": schema}
        self.send(json.dumps({"op": "advertise", "channels": [channel]}).encode())

    def publish(self, number, text):
        self.send(struct.pack("<BI", CLIENT_DATA, number) + text.encode(), kind=BINARY)

    def call(self, service, request, encoding="json"):
        """Return the response, or the reason of a failure."""
        while service not in self.services:
            self.receive()
        number, name = self.services[service]["id"], encoding.encode()
        head = struct.pack("<BIII", SERVICE_REQUEST, number, 1, len(name))
        self.send(head + name + json.dumps(request).encode(), kind=BINARY)
        while True:
            message = self.receive()
            if isinstance(message, dict) and message["op"] == "serviceCallFailure":
                return message["message"]
            if isinstance(message, bytes) and message[0] == SERVICE_RESPONSE:
                (length,) = struct.unpack("<I", message[9:13])
                return json.loads(message[13 + length :])


def upward(newtons):
    return json.dumps({"wrench": {"force": {"z": newtons}}})


def steer(port):
    """Send valid and invalid requests of a viewer to a run, and print the responses."""
    client, said = Client(port), {}
    client.advertise(1, f"{NODE}/push", "geometry_msgs/msg/WrenchStamped")
    client.advertise(2, f"{NODE}/grab", "geometry_msgs/msg/PointStamped")
    client.advertise(3, f"{NODE}/nothing", "std_msgs/msg/String")
    client.advertise(4, f"{NODE}/push", "geometry_msgs/msg/WrenchStamped", encoding="cdr")
    said["pause"] = client.call(f"{NODE}/set_simulation_state", {"state": {"state": 2}})
    for text in ("{", "[]", upward("much"), upward(float("nan")), '{"wrench": {"power": 1}}'):
        client.publish(1, text)
        said[text] = client.call(f"{NODE}/step_simulation", {"steps": 1})
    for strength in range(10_000):
        client.publish(1, upward(float(strength)))
    said["step"] = client.call(f"{NODE}/step_simulation", {"steps": 2})
    client.publish(2, json.dumps({"header": {"frame_id": "phy124"}, "point": {"z": 0.6}}))
    client.call(f"{NODE}/step_simulation", {"steps": 2})
    client.publish(2, "{}")
    client.call(f"{NODE}/step_simulation", {"steps": 1})
    said["wrong"] = client.call(f"{NODE}/step_simulation", {"steps": "many"})
    said["cdr"] = client.call(f"{NODE}/step_simulation", {}, encoding="cdr")
    client.subscribe(f"{NODE}/contact/ground")
    said["reset"] = client.call(f"{NODE}/reset_simulation", {})
    said["play"] = client.call(f"{NODE}/set_simulation_state", {"state": {"state": 1}})
    said["contact"] = len(client.data()[2])
    said["features"] = client.call(f"{NODE}/get_simulator_features", {})
    said["quit"] = client.call(f"{NODE}/set_simulation_state", {"state": {"state": 3}})
    sys.stdout.write(json.dumps(said))


if __name__ == "__main__":
    steer(int(sys.argv[1]))
