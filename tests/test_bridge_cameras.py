"""Images of cameras, read from bags by rosbags, and received over Foxglove and DDS."""

import io
import subprocess

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from bridge.camera_messages import list_topics
from bridge.cameras import Cameras, choose_view
from bridge.encoder import FrameEncoder
from bridge.messages import DEFINITIONS
from bridge.options import Options
from bridge.sinks.foxglove import FoxgloveSink
from bridge.sinks.mcap import McapSink
from bridge.sinks.rclpy import RclpySink
from bridge.steering.loop import steer
from bridge.topics import find_recorded, full_name
from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians
from phy124.io.clip import Clip
from phy124.rendering.framing import cameras
from phy124.rendering.outputs import Seen
from phy124.rendering.render import Renderer
from phy124.scene import Scene
from support import ros_double
from support.foxglove_client import Client
from support.processes import until
from support.ros_double import decoded
from support.steered import steered

SIZE = (160, 120)
IMAGE = "sensor_msgs/msg/Image"
VIDEO = "foxglove_msgs/msg/CompressedVideo"
JAZZY = get_typestore(Stores.ROS2_JAZZY)
JAZZY.register(get_types_from_msg(DEFINITIONS[VIDEO], VIDEO))
CORNERS = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 3)


def dots_clip(frames=4):
    """The corners of a cube of 1 m, as dots of different colours, which sink."""
    n = len(CORNERS)
    rgb = np.random.default_rng(124).uniform(0, 0.6, (n, 3))
    quats = np.tile([1.0, 0, 0, 0], (n, 1))
    dots = Gaussians.from_rgb(CORNERS, quats, np.full((n, 3), 0.008), np.full(n, 0.95), rgb)
    return Clip.from_frames(
        [Frame(i, i / 24, dots.transform(1.0, np.array([0, 0, -0.03 * i]))) for i in range(frames)]
    )


def options(**changes):
    return Options(**{"views": ("front", "orbit"), "size": "160x120", "epoch": 1e9, **changes})


def record(path, clip, chosen):
    with Cameras(chosen, clip.scene, clip) as seen, McapSink(path, chosen) as sink:
        for frame in map(seen.look, clip.frames()):
            sink.write(frame)
    return path


def messages(bag):
    """Topic -> messages, as rosbags reads them."""
    results = {}
    with Reader(bag) as reader:
        for connection, _, raw in reader.messages():
            message = JAZZY.deserialize_cdr(raw, connection.msgtype)
            results.setdefault(connection.topic, []).append(message)
    return results


def camera(result, name, end):
    return result[f"/phy124/player/camera/{name}/{end}"]


def pixels(image):
    kind, channels = {
        "rgb8": ("u1", 3),
        "mono8": ("u1", 1),
        "32FC1": ("f4", 1),
        "32FC2": ("f4", 2),
    }[image.encoding]
    assert image.step == image.width * channels * np.dtype(kind).itemsize
    return np.frombuffer(image.data, kind).reshape(image.height, image.width, channels)


def project(points, info, link):
    """Pixels by K and TF, in ROS's convention: the centre of the first pixel is (0, 0)."""
    q, t = link.transform.rotation, link.transform.translation
    seen = Rotation.from_quat([q.x, q.y, q.z, q.w]).inv().apply(points - [t.x, t.y, t.z])
    image = seen @ info.k.reshape(3, 3).T
    return image[:, :2] / image[:, 2:]


def test_points_land_on_their_pixels(tmp_path):
    clip = dots_clip()
    result = messages(record(tmp_path / "bag", clip, options(images=("mask",))))
    for index in range(len(clip)):
        (fixed,) = [
            link
            for link in result["/tf_static"][-1].transforms
            if link.child_frame_id == "phy124_camera_front_optical"
        ]
        (moving,) = result["/tf"][index].transforms
        assert moving.child_frame_id == "phy124_camera_orbit_optical"
        for name, link in (("front", fixed), ("orbit", moving)):
            info = camera(result, name, "camera_info")[index]
            assert (info.width, info.height, *info.d) == (*SIZE, 0, 0, 0, 0, 0)
            assert info.header.frame_id == link.child_frame_id
            np.testing.assert_array_equal(info.p.reshape(3, 4)[:, :3], info.k.reshape(3, 3))
            mask = pixels(camera(result, name, "mask")[index])[..., 0].astype(float)
            for x, y in project(clip.means[index], info, link):
                left, top = round(x) - 4, round(y) - 4
                spot = mask[top : top + 9, left : left + 9]
                rows, columns = np.mgrid[top : top + 9, left : left + 9]
                centre = np.array([(columns * spot).sum(), (rows * spot).sum()]) / spot.sum()
                assert np.abs(centre - [x, y]).max() < 0.1


def test_images_are_those_of_the_renderer(tmp_path):
    clip = dots_clip()
    chosen = options(images=("rgb", "depth", "flow", "jpeg"))
    result = messages(record(tmp_path / "bag", clip, chosen))
    view = choose_view(chosen, Scene())
    for side in view.sides:
        path = cameras(clip, view, side)
        seen = Seen(clip, path, ("depth", "flow"))
        for index in range(len(clip)):
            picture = Renderer().picture(clip.frame(index).gaussians, path[index])
            np.testing.assert_array_equal(pixels(camera(result, side, "image_raw")[index]), picture)
            packed = camera(result, side, "image_raw/compressed")[index]
            opened = np.asarray(Image.open(io.BytesIO(packed.data)), float)
            assert np.abs(opened - picture).mean() < 3
            rasters, covered = seen.rasters(Renderer(), index)
            depth = pixels(camera(result, side, "depth")[index])
            np.testing.assert_array_equal(depth[covered], rasters["depth"][covered])
            assert np.isnan(depth[~covered]).all()
        assert len(camera(result, side, "flow")) == len(clip) - 1
    # A dot that sinks moves downwards by f * distance / depth.
    flow, mask = pixels(camera(result, "front", "flow")[0]), covered
    down = flow[..., 1][flow[..., 1] != 0]
    focal = camera(result, "front", "camera_info")[0].k[4]
    nearest, farthest = (focal * 0.03 / (path[0].eye[0] - x) for x in (0.5, -0.5))
    assert mask.any() and down.min() > 0.9 * farthest and down.max() < 1.2 * nearest


def test_video_has_one_picture_per_message(tmp_path):
    clip = dots_clip(6)
    result = messages(
        record(tmp_path / "bag", clip, options(images=("rgb", "h264"), size="161x99"))
    )
    units = [bytes(message.data) for message in camera(result, "front", "video")]
    pictures = [pixels(image) for image in camera(result, "front", "image_raw")]
    # Each message begins with an access unit delimiter; only the first has parameter sets (7).
    assert all(unit.startswith(b"\0\0\0\1\x09") for unit in units)
    assert [b"\0\0\1\x67" in unit for unit in units] == [True] + [False] * 5
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(),
        *["-v", "error", "-f", "h264", "-i", "-", "-f", "rawvideo"],
    ]
    done = subprocess.run(
        [*command, "-pix_fmt", "rgb24", "-"], input=b"".join(units), capture_output=True, check=True
    )
    decoded = np.frombuffer(done.stdout, np.uint8).reshape(len(units), 100, 162, 3)[:, :99, :161]
    assert np.abs(decoded - np.array(pictures, float)).mean() < 3


def test_cameras_are_off_by_default():
    clip = dots_clip()
    with Cameras(Options(), {"not": "read"}, clip) as seen:
        frame = clip.frame(0)
        assert seen.look(frame) is frame
    assert [topic.name for topic in FrameEncoder(Options()).topics] == [
        "/tf_static",
        "/phy124/points",
    ]


def test_names_of_cameras(tmp_path):
    file = tmp_path / "cameras.toml"
    file.write_text(
        '[[view.cameras]]\nkind = "dolly"\n[[view.cameras]]\nkind = "path"\nname = "a-b"'
    )
    scene = {"view": {"cameras": [{"kind": "turntable", "name": "table"}]}}
    chosen = options(views=("right", "table", "52.5"), cameras=file)
    assert chosen.camera_names == ("right", "table", "azimuth_52_5", "dolly", "a_b")
    with Cameras(chosen, scene, dots_clip()) as seen:
        pictures = seen.look(dots_clip().frame(1)).pictures
    fixed = {picture.name: picture.fixed for picture in pictures}
    assert fixed.keys() == set(chosen.camera_names)
    assert [name for name in fixed if not fixed[name]] == ["table", "dolly"]
    for topic in list_topics(chosen):
        name = full_name(topic.name, "live")
        assert find_recorded(name).type == topic.type
    assert find_recorded("/phy124/live/camera/front/other") is None


def test_a_camera_may_have_the_name_contact():
    recorded = find_recorded("/phy124/live/camera/contact/image_raw")
    assert recorded.type == IMAGE


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"views": ("top",)}, "views = top: the scene has no such camera."),
        ({"views": ("front", "front")}, "their names must differ"),
        ({"size": "7x"}, "size"),
        ({"cameras": "no.toml"}, "there is no such file"),
    ],
)
def test_refusals(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        Cameras(options(**changes), {}, dots_clip())


def test_live_cameras_stay_where_the_object_rested():
    chosen = options(images=("rgb", "flow"))
    run, shown = steered(), []
    with Cameras(chosen, run.live.scene.data()) as seen:
        sink = type("Sink", (), {"show": lambda *_: None, "listen": lambda *_: None})()
        sink.send, sink.write = shown.append, shown.append
        run.enter(1)
        steer(run, sink, chosen, look=seen.look, frames=3)
    frames = [frame for frame in shown if isinstance(frame, Frame)]
    front, orbit = zip(*(frame.pictures for frame in frames), strict=True)
    assert len(front) == 3 and len({picture.camera.eye for picture in front}) == 1
    assert len({picture.camera.eye for picture in orbit}) == 3
    assert [("flow" in picture.images) for picture in front] == [False, True, True]
    assert all((picture.images["rgb"] < 250).any() for picture in front)


def test_circling_camera_goes_on_after_the_scene():
    clip = dots_clip()
    scene = Scene().replaced({"time.frames": 4}).data()
    with Cameras(options(images=("mask",)), scene) as seen:
        first, *_ = [seen.look(Frame(i, i / 24, clip.frame(0).gaussians)) for i in range(4)]
        again = seen.look(Frame(4, 4 / 24, clip.frame(0).gaussians))
    assert first.pictures[1].camera == again.pictures[1].camera
    assert again.pictures[0].camera == first.pictures[0].camera


def seen_frames(clip, chosen):
    with Cameras(chosen, clip.scene, clip) as seen:
        return [seen.look(frame) for frame in clip.frames()]


def test_rclpy_publishes_cameras(monkeypatch):
    ros = ros_double.install(monkeypatch)
    chosen = options(images=("rgb", "depth"))
    with RclpySink(chosen) as sink:
        for frame in seen_frames(dots_clip(), chosen):
            sink.write(frame)
    (made,) = ros.nodes
    (first, *_, last) = decoded(made.publishers["~/camera/front/image_raw"], IMAGE)
    assert (first.header.frame_id, last.width, last.height) == (
        "phy124_camera_front_optical",
        *SIZE,
    )
    # The last static transforms are whole: a late subscriber gets no others.
    *_, links = decoded(made.publishers["/tf_static"], "tf2_msgs/msg/TFMessage")
    assert [link.child_frame_id for link in links.transforms] == ["phy124", first.header.frame_id]
    assert len(made.publishers["/tf"].sent) == 4
    with pytest.raises(
        InputError, match=r"foxglove_msgs is not installed\. Install ros-DISTRO-fox"
    ):
        RclpySink(options(images=("h264",))).__enter__()


def test_foxglove_shows_cameras():
    pytest.importorskip("foxglove")
    chosen = options(views=("front",))
    first, second, *_ = seen_frames(dots_clip(), chosen)
    with FoxgloveSink(chosen, duration=0.1, port=0) as sink:
        client = Client(sink.port)
        sink.write(first)
        client.subscribe("/phy124/player/camera/front/depth")
        # A new viewer gets the latest picture of this topic alone.
        sink.listen(10.0, lambda text: None)
        sink.write(second)
        shown = [JAZZY.deserialize_cdr(client.data()[2], IMAGE) for _ in range(2)]
        client.close()
    for frame, image in zip((first, second), shown, strict=True):
        np.testing.assert_array_equal(pixels(image)[..., 0], frame.pictures[0].images["depth"])


def test_dds_publishes_cameras(domain):
    pytest.importorskip("cyclonedds")
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic as DdsTopic

    from bridge.idl import idl_type
    from bridge.sinks.dds import DdsSink, quality

    chosen = options(views=("front",), size="32x24", images=("rgb",))
    (frame,) = seen_frames(dots_clip(1), chosen)
    with DdsSink(chosen) as sink:
        peer, result = DomainParticipant(domain), []
        readers = []
        for topic in list_topics(chosen):
            name = f"rt{full_name(topic.name, 'player')}"
            dds_topic = DdsTopic(peer, name, idl_type(topic.type))
            readers.append(DataReader(peer, dds_topic, qos=quality(topic)))
        sink.write(frame)

        def arrived():
            result.extend(sample for reader in readers for sample in reader.take(5))
            return len(result) == 2

        until(arrived)
    info, image = sorted(result, key=lambda sample: hasattr(sample, "encoding"))
    assert info.k[2] == 15.5
    np.testing.assert_array_equal(image.data, frame.pictures[0].images["rgb"].ravel())
