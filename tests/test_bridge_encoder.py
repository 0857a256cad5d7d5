"""Frames to messages: transform, thinning, ellipsoids, stamps; read back by rosbags."""

import logging
import time

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from bridge.encoder import CLEARING, DELETE_ALL, FrameEncoder
from bridge.options import Options
from bridge.topics import ELLIPSOIDS, POINTS, TF_STATIC
from phy124.gaussians import rotation_matrices
from support.clips import random_clip

JAZZY = get_typestore(Stores.ROS2_JAZZY)
EPOCH = 1_700_000_000


def decoded(message):
    return JAZZY.deserialize_cdr(message.data, message.topic.type)


def test_static_transform_hangs_the_world_on_its_parent():
    turn = (0.1, 0.5, -0.5, 0.7)
    options = Options(translation=(1, 2, 3), rotation=turn, parent_frame="odom", epoch=EPOCH)
    (message,) = FrameEncoder(options).static()
    (transform,) = decoded(message).transforms
    assert message.topic is TF_STATIC
    assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "phy124")
    assert transform.header.stamp.sec == EPOCH
    moved = transform.transform.translation
    assert (moved.x, moved.y, moved.z) == (1, 2, 3)
    turned = transform.transform.rotation
    assert (turned.x, turned.y, turned.z, turned.w) == pytest.approx(turn)


def test_no_parent_no_transform():
    encoder = FrameEncoder(Options(parent_frame=""))
    assert encoder.static() == []
    assert encoder.topics == [POINTS]


def test_stamps_count_from_the_epoch():
    encoder = FrameEncoder(Options(epoch=EPOCH))
    (message,) = encoder.encode(random_clip().frame(3))
    assert message.stamp == EPOCH * 10**9 + 100_000_000
    header = decoded(message).header
    assert (header.stamp.sec, header.stamp.nanosec) == (EPOCH, 100_000_000)
    assert header.frame_id == "phy124"


def test_default_epoch_is_now():
    before = time.time_ns()
    assert before <= FrameEncoder(Options()).epoch <= time.time_ns()


def test_thinning_is_announced_once_and_the_same_in_each_frame(caplog):
    clip = random_clip(count=100)
    encoder = FrameEncoder(Options(max_points=30))
    with caplog.at_level(logging.WARNING):
        clouds = [decoded(encoder.encode(frame)[0]) for frame in clip.frames()]
        FrameEncoder(Options(max_points=20), quiet=True).encode(clip.frame(0))
    assert [text.message for text in caplog.records] == [
        "Sending 30 of 100 Gaussians, evenly selected (max_points)."
    ]
    kept = np.arange(30) * 100 // 30
    for i, cloud in enumerate(clouds):
        x = cloud.data.view(np.float32).reshape(30, -1)[:, 0]
        np.testing.assert_array_equal(x, clip.means[i, kept, 0])


def test_missing_velocities_are_announced(caplog):
    FrameEncoder(Options()).encode(random_clip(velocities=False).frame(0))
    assert "vx, vy and vz are NaN" in caplog.text
    caplog.clear()
    FrameEncoder(Options(profile="viz")).encode(random_clip(velocities=False).frame(0))
    assert not caplog.text


def test_ellipsoids_are_the_covariances():
    frame = random_clip(count=40).frame(0)
    encoder = FrameEncoder(Options(ellipsoids=10, ellipsoid_radius=2))
    markers = decoded(encoder.encode(frame)[1]).markers
    assert ELLIPSOIDS in encoder.topics
    chosen = frame.gaussians.select(np.arange(10) * 4)
    for i, marker in enumerate(markers[1:]):
        q, s = marker.pose.orientation, marker.scale
        rotation = rotation_matrices(np.array([[q.w, q.x, q.y, q.z]]))[0]
        axes = rotation * (np.array([s.x, s.y, s.z]) / 4)
        np.testing.assert_allclose(axes @ axes.T, chosen.covariances()[i], rtol=1e-5, atol=1e-9)
        assert (marker.id, marker.type, marker.color.a) == (i, 2, chosen.opacities[i])
    assert len(markers) == 11


def test_ellipsoids_of_another_clip_are_deleted():
    frame, encoder = random_clip(count=3).frame(0), FrameEncoder(Options(ellipsoids=2))
    sent = [decoded(encoder.encode(frame)[1]).markers for _ in range(CLEARING + 1)]
    actions = [[marker.action for marker in markers] for markers in sent]
    assert actions == [[DELETE_ALL, 0, 0]] * CLEARING + [[0, 0]]


def test_flat_gaussians_still_have_a_visible_marker():
    frame = random_clip(count=2).frame(0)
    frame.gaussians.scales[:] = 0
    markers = decoded(FrameEncoder(Options(ellipsoids=2)).encode(frame)[1]).markers
    assert all(marker.scale.x > 0 for marker in markers[1:])
