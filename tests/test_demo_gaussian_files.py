"""Files of Gaussians in place of a picture: read apart, drawn all ways up, or refused in words."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from demo import source as module
from demo.catalogue import catalogue
from demo.jobs import Studio
from demo.room import Room
from demo.settings import Settings
from demo.source import Choice, Cutout, GaussianFile
from demo.visitors import Visitors
from demo.work import gaussians_of, made_gaussians
from phy124.errors import InputError
from phy124.generators.ply_file import PlyFile, Reading
from phy124.io import ply
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.dialect import Axes
from phy124.io.formats import object_endings
from phy124.rendering.orienting import UPS
from phy124.runtime.isolated import Deadline, Unfinished
from phy124.scene import Scene
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"
SOON = Deadline(60)
HEAD, ROWS = ply.encode(rotate_gaussians(ball(1200), orientation("y", "z").T)).split(
    b"end_header\n"
)
# No program has signed it.
HEAD = b"".join(line for line in HEAD.splitlines(keepends=True) if b"comment" not in line)


def of(rows: bytes = ROWS, head: bytes = HEAD) -> bytes:
    return head + b"end_header\n" + rows


def changed(**columns: float) -> bytes:
    """The file with other values of some properties."""
    names = [line.split()[-1].decode() for line in HEAD.splitlines() if b"property" in line]
    table = np.frombuffer(ROWS, "<f4").reshape(-1, len(names)).copy()
    for name, value in columns.items():
        table[:, names.index(name)] = value
    return of(table.tobytes())


@pytest.fixture(autouse=True)
def unlimited(monkeypatch):
    """Read in this process, which is quicker and must not be limited."""
    monkeypatch.setattr(module.isolated, "run", lambda work, *options, **_: work(*options))


@pytest.fixture
def studio(tmp_path) -> Studio:
    return Studio(Settings(gaussians=1000, max_file_mb=0.5, max_upload_mb=0.1), Visitors(tmp_path))


def sent(studio: Studio, data: bytes, ending: str = ".ply") -> str:
    studio.visitors.get("a")
    return str(studio.visitors.store("a", data, ending))


def read(studio: Studio, data: bytes) -> GaussianFile:
    job = studio.take("a", sent(studio, data))
    assert job.wait(60) and job.progress.result, job.progress.message
    return job.progress.result


def test_ignored_content_of_a_file_is_in_its_notes(studio):
    file = read(studio, of(head=HEAD.replace(b"property float nx", b"property float metallic")))
    assert file.notes[0] == "Unknown columns are ignored: metallic."


def test_file_is_thinned_drawn_in_24_poses_and_simulated(studio):
    file = read(studio, of())
    assert (file.format, file.axes[:3]) == ("3DGS PLY", ("-y", "x", False))
    assert file.count <= 1000 and "1,200 Gaussians were reduced to 1,000" in file.notes[0]
    with Image.open(file.picture) as picture:
        assert picture.size == (module.SIZE,) * 2
        alpha = picture.getchannel("A")
        assert alpha.getpixel((0, 0)) == 0, "it stands on the stage without a white card"
        assert alpha.getextrema()[1] > 250
    made = {path.stem for path in file.pictures.glob("*.webp")}
    assert len(made) == 24 and {name.split("_")[0] for name in made} == set(UPS)
    visitor, scene = studio.visitors.get("a"), Scene.named("press")

    def order(answer):
        return studio.order((visitor, file, scene), studio.check_extras("a", answer))

    chosen, other = order({"up": "y", "front": "z"}), order(None)
    assert (other.extras.reading.up, other.extras.reading.front) == ("-y", "x")
    assert order({"up": "z"}).extras.reading == Reading(up="z")
    assert made_gaussians(chosen) != made_gaussians(other)
    standing = gaussians_of(chosen, made_gaussians(chosen))
    wanted = PlyFile(file.path, Reading(up="y", front="z"))()
    np.testing.assert_array_equal(standing.means, wanted.means)
    assert dict(chosen.about)["file"] == {"up": "y", "front": "z", "program": file.axes.program}


def test_regions_in_the_units_of_the_file_are_turned_with_it(studio):
    file, visitor = read(studio, of()), studio.visitors.get("a")
    region = {"lower": (-9, -9, -9), "upper": (9, 0, 9), "units": "file"}
    part = {"region": region, "material": {"law": "neo_hookean", "E": 2e5}}
    scene = Scene.named("press").replaced({"parts": [part]})
    order = studio.order(
        (visitor, file, scene), studio.check_extras("a", {"up": "y", "front": "z"})
    )
    turned_part = order.scene.parts[0].region
    assert turned_part is not None and turned_part.units == "metres"
    x = np.array([[0, 0, 0.4], [0, 0, -0.4]]) + [0, 0, scene.object.size / 2]
    assert turned_part.contains(x).tolist() == [False, True], "what the file has below is below"


@pytest.mark.parametrize(
    ("data", "limit"),
    [
        (of()[:200], "cut short within its header"),
        (of(ROWS[:-5000]), "cut short: "),
        (of(head=HEAD.replace(b"1200", b"1000000000")), "states 1,000,000,000 Gaussians; the"),
        (changed(x=np.nan), "None of its Gaussians has finite values"),
        (changed(opacity=-20), "below 0.005"),
        (changed(x=0, y=0, z=0), "at a single point"),
        (of(ROWS[: len(ROWS) // 1200], HEAD.replace(b"1200", b"1")), "at a single point"),
        (DUCK.read_bytes(), "The file is not a PLY file"),
        (b"", "The file is empty"),
    ],
)
def test_broken_file_gets_a_sentence_and_leaves_nothing(studio, data, limit):
    job = studio.take("a", sent(studio, data))
    assert job.wait(60) and job.progress.state == "refused"
    assert limit in job.progress.message and str(studio.visitors.root) not in job.progress.message
    assert not any((studio.visitors.get("a").folder / "objects").iterdir())


@pytest.mark.parametrize(
    ("broken", "limit"),
    [
        (Unfinished("did not finish within 60 s"), "Reading the file did not finish within 60 s."),
        (Unfinished("broke down (exit status -6: /x)"), "Reading the file broke down."),
        (MemoryError(), "more than 3 GB of memory"),
    ],
)
def test_a_file_that_takes_too_much_is_refused(tmp_path, monkeypatch, broken, limit):
    def fail(*_, deadline, memory):
        raise broken

    monkeypatch.setattr(module.isolated, "run", fail)
    with pytest.raises(InputError, match=limit):
        module.open_gaussians(tmp_path / "a.ply", tmp_path, 1000, SOON)


def test_file_type_follows_content_and_has_limits(studio):
    assert studio.take("a", sent(studio, of(), ".png")).kind == "read"
    with pytest.raises(InputError, match=r"larger than 0\.5 MB"):
        studio.take("a", sent(studio, of(10 * ROWS)))
    with pytest.raises(InputError, match="only one object"):
        studio.take("a", sent(studio, of()), (0.5, 0.5))
    assert catalogue(studio.settings)["limits"]["file_endings"] == object_endings()


def test_files_that_were_read_fit_into_the_visitors_room(tmp_path):
    studio = Studio(Settings(gaussians=1000), Visitors(tmp_path, Room(each=600_000)))
    for _ in range(5):
        assert Path(read(studio, of()).path).exists()
        assert studio.visitors.get("a").measure() <= 600_000


def test_reading_options_must_suit_the_object(studio):
    file = GaussianFile("a.ply", "3DGS PLY", 10, Axes("-y", "-z", False))
    for answer, source, option in (
        ({"up": "y"}, Cutout("", ""), "up"),
        ({"thickness": 0.5}, file, "thickness"),
        ({"near": "black"}, file, "near"),
    ):
        with pytest.raises(InputError, match="Remove it") as refused:
            studio.check_extras("a", answer).suit(source)
        assert refused.value.field == option
    for answer in ({"up": "w"}, {"up": "y", "front": "-y"}):
        with pytest.raises(InputError, match=r"axis"):
            studio.check_extras("a", answer)


def test_the_forecast_is_that_of_the_file(studio):
    # On a lattice the number of particles does not depend on that of the Gaussians.
    scene = Scene.named("press").replaced({"binding": "particles"}).data()
    file = read(studio, of())
    small = replace(file, count=file.count // 8)
    both = [
        studio.forecaster(Scene.from_data(scene), gaussians=studio.count(item), generated=True)
        for item in (file, small)
    ]
    assert both[0].seconds > both[1].seconds
    # The seconds depend on the load of the machine and on kernels that are not compiled yet.
    ours = studio.forecast(Choice("a", file, scene))
    assert (ours.particles, ours.substeps) == (both[0].particles, both[0].substeps)
    assert ours.particles > both[1].particles
