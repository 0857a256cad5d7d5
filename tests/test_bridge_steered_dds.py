"""Runs that are steered over DDS, by peers that know nothing of the bridge but names and types."""

import os
import struct
import subprocess
import sys
import time

import numpy as np
import pytest

from support.pages import ROOT
from support.processes import until
from support.steered import OPTIONS, WEIGHTLESS, steered

pytest.importorskip("cyclonedds")

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from bridge import cdr
from bridge.discovery import Discovery
from bridge.idl import LATER, _struct, idl_type, service_type
from bridge.sinks.dds import DdsSink
from bridge.steering.loop import controls, steer
from bridge.steering.run import State

QOS = Qos(
    Policy.Reliability.Reliable(100_000_000),
    Policy.History.KeepLast(100),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
MOST = 24 * 600
"""Frames after which nobody will come any more."""


class Peer:
    """Reads and writes topics of ROS 2 with types that cyclonedds encodes by itself."""

    def __init__(self, domain):
        self.participant = DomainParticipant(domain)
        self.kept = []

    def topic(self, name, kind):
        self.kept.append(Topic(self.participant, name, kind))
        return self.kept[-1]

    def reader(self, name, kind):
        return DataReader(self.participant, self.topic(name, idl_type(kind)), qos=QOS)

    def writer(self, name, kind):
        return DataWriter(self.participant, self.topic(name, idl_type(kind)), qos=QOS)

    def ask(self, sink, service, *members, number=7):
        """Call a service as a client of rmw_cyclonedds_cpp does; returns the response's members.

        Requests and responses have the same header.
        """
        name, kind = f"/phy124/live/{service[0]}", f"simulation_interfaces/srv/{service[1]}"
        asked = service_type(f"{kind}_Request")
        writer = DataWriter(self.participant, self.topic(f"rq{name}Request", asked), qos=QOS)
        reply = self.topic(f"rr{name}Reply", service_type(f"{kind}_Response"))
        reader = DataReader(self.participant, reply, qos=QOS)
        until(lambda: writer.get_matched_subscriptions() and reader.get_matched_publications())
        # The other side needs a moment after the match.
        time.sleep(0.1)
        writer.write(asked(4711, number, *members))
        answers = []

        def answered():
            sink.listen(0.02, lambda text: None)
            answers.extend(reader.take(1))
            return answers

        until(answered)
        assert (answers[0].client, answers[0].number) == (4711, number)
        return answers[0]


def opened(run):
    return DdsSink(OPTIONS, controls=controls(run, OPTIONS, "coarse", action=False))


def test_requests_of_both_versions_are_read():
    name = "simulation_interfaces/srv/SetEntityState_Request"
    header = {"client": types.uint64, "number": types.int64}
    for flags in ({}, {"set_pose": True, "set_twist": False, "set_acceleration": True}):
        kind = _struct(name, header, LATER[name] if flags else {})
        state = idl_type("simulation_interfaces/msg/EntityState")
        empty = cdr.encode(
            "simulation_interfaces/msg/EntityState", {"pose": {"position": {"x": 3}}}
        )
        sent = kind(1, 2, "ball", state.deserialize(empty), *flags.values())
        read = service_type(name).deserialize(sent.serialize(use_version_2=False))
        assert (read.number, read.entity, read.state.pose.position.x) == (2, "ball", 3)
        assert {key: getattr(read, key) for key in LATER[name] if hasattr(read, key)} == flags


def test_a_peer_pauses_steps_and_pushes(domain):
    run = steered(changes=WEIGHTLESS, paused=False)
    with opened(run) as sink:
        peer = Peer(domain)
        run.show = sink.write
        run.advance()
        state = idl_type("simulation_interfaces/msg/SimulationState")
        answer = peer.ask(sink, ("set_simulation_state", "SetSimulationState"), state(2))
        assert (answer.result.result, run.state) == (1, State.PAUSED)
        features = peer.ask(sink, ("get_simulator_features", "GetSimulatorFeatures"), 0).features
        assert 31 in features.features and "~/push" in features.custom_info
        answer = peer.ask(sink, ("get_entity_state", "GetEntityState"), "object", number=5)
        assert answer.state.pose.position.z == pytest.approx(run.live.centre[2])
        answer = peer.ask(sink, ("delete_entity", "DeleteEntity"), "robot", number=6)
        assert answer.result.result == 2 and "no 'robot'" in answer.result.error_message
        writer = peer.writer("rt/phy124/live/push", "geometry_msgs/msg/WrenchStamped")
        until(writer.get_matched_subscriptions)
        time.sleep(0.1)
        vector = idl_type("geometry_msgs/msg/Vector3")
        header = idl_type("std_msgs/msg/Header")(idl_type("builtin_interfaces/msg/Time")(0, 0), "")
        pushed = idl_type("geometry_msgs/msg/Wrench")(vector(60, 0, 0), vector(0, 0, 0))
        writer.write(idl_type("geometry_msgs/msg/WrenchStamped")(header, pushed))
        until(lambda: sink.listen(0.02, lambda text: None) or run.inputs._pushes)
        answer = peer.ask(sink, ("step_simulation", "StepSimulation"), 3, number=8)
        assert answer.result.result == 1 and run.live.count == 4
        answer = peer.ask(sink, ("step_simulation", "StepSimulation"), 2**63, number=9)
        assert (
            answer.result.result == 4
            and "whole number up to 100,000" in answer.result.error_message
        )
    (force,) = run.live.session().forces
    assert force.force == (60, 0, 0) and run.live.centre[0] > 0


def test_a_controller_closes_the_loop_and_may_die(domain):
    """docs/guide/push_square.py in a process of its own, killed at work."""
    run, ways = steered(changes=WEIGHTLESS, paused=False), []
    command = [sys.executable, ROOT / "docs/guide/push_square.py", "--mass", "500", "--each", "0.5"]

    class Watch:
        killed = None

        def write(self, frame):
            ways.append(run.live.centre)
            pushes = run.live.session().forces
            if self.killed is None and len(pushes) > 10:
                controller.kill()
                self.killed = len(ways)
            if (self.killed and len(ways) > self.killed + 10) or len(ways) > MOST:
                run.enter(State.QUITTING)

        def send(self, message):
            """Store a message that is not part of a frame."""

    watch, (settings, *_) = Watch(), Discovery.from_environment().configurations()
    environment = {**os.environ, "CYCLONEDDS_URI": settings}
    piped = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    with opened(run) as sink, piped as controller:
        try:
            steer(run, sink, OPTIONS, records=[watch])
        finally:
            controller.kill()
        assert controller.stdout.read().startswith("waiting for phy124_com on /tf in domain ")
    assert watch.killed is not None, "no answer came"
    last = run.live.session().forces[-1]
    # What had come over is still done, and no wrench is longer than it is allowed to be.
    assert last.end <= (watch.killed + 2) / 24 + 0.1 + 1e-9
    steps = np.diff(ways, axis=0)
    assert np.linalg.norm(steps[-1]) > 1e-4 and np.allclose(steps[-1], steps[-3], rtol=0.01)
    assert not run.remarks.count


def test_bridge_and_peer_agree_on_the_header_of_a_request():
    kind = service_type("simulation_interfaces/srv/StepSimulation_Request")
    data = kind(4711, -1, 5).serialize(use_version_2=False)
    assert data == b"\0\1\0\0" + struct.pack("<QqQ", 4711, -1, 5)
