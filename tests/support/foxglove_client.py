"""A client of a few lines (RFC 6455 and Foxglove's protocol), also as a process of its own."""

import base64
import json
import os
import socket
import struct
import sys

TEXT, BINARY = 1, 2
MESSAGE_DATA, PLAYBACK_STATE, PLAYBACK_REQUEST = 1, 5, 3
CLIENT_DATA, SERVICE_REQUEST, SERVICE_RESPONSE = 1, 2, 3
NODE = "/phy124/live"


class Client:
    """A websocket client that can subscribe and move the playback controls."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=60)
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
            f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        self.stream = self.socket.makefile("rb")
        assert b"101" in self.stream.readline()
        while self.stream.readline().strip():
            pass
        self.channels, self.services = {}, {}
        self.info = self.text("serverInfo")

    def receive(self):
        """The next text message as an object, or binary message as bytes."""
        first, second = self.stream.read(2)
        length = second & 0x7F
        if length >= 126:
            form = ">H" if length == 126 else ">Q"
            (length,) = struct.unpack(form, self.stream.read(struct.calcsize(form)))
        payload = self.stream.read(length)
        if first & 0x0F != TEXT:
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

    def send(self, payload, kind):
        mask = os.urandom(4)
        masked = bytes(byte ^ mask[i % 4] for i, byte in enumerate(payload))
        size = len(masked)
        head = bytes([0x80 | size]) if size < 126 else struct.pack(">BH", 0x80 | 126, size)
        self.socket.sendall(bytes([0x80 | kind]) + head + mask + masked)

    def subscribe(self, *topics):
        while not set(topics) <= self.channels.keys():
            self.receive()
        wanted = [{"id": i, "channelId": self.channels[t]["id"]} for i, t in enumerate(topics)]
        self.send(json.dumps({"op": "subscribe", "subscriptions": wanted}).encode(), TEXT)

    def control(self, playing, speed=1.0, seek=None, request="r1"):
        sought = struct.pack("<BQ", seek is not None, seek or 0)
        name = request.encode()
        body = struct.pack("<BBf", PLAYBACK_REQUEST, 0 if playing else 1, speed) + sought
        self.send(body + struct.pack("<I", len(name)) + name, BINARY)

    def data(self):
        """Subscription, log time and payload of the next message."""
        message = self.binary(MESSAGE_DATA)
        return *struct.unpack("<IQ", message[:12]), message[12:]

    def advertise(self, number, topic, schema, encoding="json"):
        channel = {"id": number, "topic": topic, "encoding": encoding, "schemaName": schema}
        self.send(json.dumps({"op": "advertise", "channels": [channel]}).encode(), TEXT)

    def publish(self, number, text):
        self.send(struct.pack("<BI", CLIENT_DATA, number) + text.encode(), BINARY)

    def call(self, service, request, encoding="json"):
        """The response, or the reason of a failure."""
        while service not in self.services:
            self.receive()
        number, name = self.services[service]["id"], encoding.encode()
        head = struct.pack("<BIII", SERVICE_REQUEST, number, 1, len(name))
        self.send(head + name + json.dumps(request).encode(), BINARY)
        while True:
            message = self.receive()
            if isinstance(message, dict) and message["op"] == "serviceCallFailure":
                return message["message"]
            if isinstance(message, bytes) and message[0] == SERVICE_RESPONSE:
                (length,) = struct.unpack("<I", message[9:13])
                return json.loads(message[13 + length :])

    def close(self):
        self.stream.close()
        self.socket.close()


def upward(newtons):
    return json.dumps({"wrench": {"force": {"z": newtons}}})


def steer(port):
    """Do to a run what a viewer may do, and what it should not; prints what came back."""
    client, said = Client(port), {}
    client.advertise(1, f"{NODE}/push", "geometry_msgs/msg/WrenchStamped")
    client.advertise(2, f"{NODE}/grab", "geometry_msgs/msg/PointStamped")
    client.advertise(3, f"{NODE}/nothing", "std_msgs/msg/String")
    client.advertise(4, f"{NODE}/push", "geometry_msgs/msg/WrenchStamped", encoding="cdr")
    said["pause"] = client.call(f"{NODE}/set_simulation_state", {"state": {"state": 2}})
    for text in ("{", "[]", upward("much"), upward(float("nan")), '{"wrench": {"power": 1}}'):
        client.publish(1, text)
        said[text] = client.call(f"{NODE}/step_simulation", {"steps": 1})
    for strength in range(2000):
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
