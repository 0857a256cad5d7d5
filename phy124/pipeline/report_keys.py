"""Declares the keys of report.json; every run writes this file and stores it in its clip.

A `NotRequired` key is present only if the option or field named in its description requests it. A
user's observer may add keys. Keys are stable: the changelog names each key that a release removes.
"""

from typing import Any

from typing_extensions import NotRequired, TypedDict


class CutOut(TypedDict):
    """Method and quality of the cut-out that `cutout.png` shows."""

    method: str
    """alpha, birefnet, birefnet-512, isnet, u2net, u2netp, grabcut, mask or brush."""
    coverage: float
    """Fraction of the picture that the object covers."""
    pieces: int
    """Number of connected pieces."""
    touches: list[str]
    """Edges of the picture that the object touches."""
    unseen: float
    """Fraction of the outline that lies on the edge of the picture."""
    alike: float
    """Fraction of the background whose colours are similar to the object's."""
    undecided: float
    """Fraction of pixels that are half transparent although they are not near the outline."""
    frames: int
    """Number of frames, if the picture is an animation; only the first frame is used."""
    objects: int
    """Number of separate objects that were detected in the picture."""
    touching: bool
    """Whether the cut-out may contain two objects that touch each other."""
    warnings: list[str]
    """Reasons to doubt the cut-out."""
    notes: list[str]
    """Parts of the picture file that were ignored."""


class Substep(TypedDict):
    """Length of the substeps."""

    mean: float
    """Mean length of the substeps [s]."""
    asked: float | None
    """`time.substep` of the scene [s]; null if the scene sets none."""
    split: bool
    """Whether the substeps are shorter than `asked`."""
    fractions: dict[str, float]
    """Name of a limit -> fraction of the substeps whose length this limit determined."""
    rejected: int
    """Number of substeps that were repeated with a shorter length."""
    retried: list[int]
    """Indices of the frames that were computed again with shorter substeps."""


class Tearing(TypedDict):
    """Data about elastic particles that may have lost contact with their neighbours."""

    apart: int
    """Largest number of particles that are stretched apart in one frame."""
    stretch: float
    """Largest stretch of the particles that are stretched apart."""
    loose: int
    """Number of particles that separated from the rest of their piece."""
    likely: bool
    """Whether the grid probably tore the material."""


class Balance(TypedDict):
    """Results of the watchdog."""

    energy_gain: float | None
    """Energy created by numerical errors, as a fraction of the supplied energy. It is negative if
    energy was lost, and null if the energy balance was not computed.
    """
    momentum_gain: float | None
    """Momentum created by numerical errors, as a fraction of the exchanged momentum; null if the
    momentum balance was not computed.
    """
    min_J: float
    """Smallest volume ratio J of all particles."""
    max_J: float
    """Largest volume ratio J of all particles."""
    inside_out: int
    """Number of inverted particles."""
    reset: int
    """Number of deformation gradients that were reset to the rest shape."""
    ballistic: int
    """Number of particles outside the simulated space; gravity is the only force on them."""
    tearing: Tearing
    """Signs that the grid has torn the material (numerical fracture)."""


class Promise(TypedDict):
    """Error bound of the clip; docs/results/accuracy.md explains it."""

    error: float | None
    """Upper bound of the error, as a fraction of the object's size. It is null if no similar scene
    was measured, or if the material tore or the run stopped early.
    """
    why: str
    """Sentence that explains where the value of `error` comes from, or why it is null."""
    unmeasured: str
    """Kind of the scene, if `error` is null because no scene of this kind was measured."""
    about: float | None
    """Error that was estimated on this scene itself, as a fraction of the object's size; null if
    there is no such estimate.
    """
    seconds: float | None
    """Time up to which the bound holds [s]; null if it holds for the whole clip."""
    unestimated: str
    """Reason why the run did not estimate its own error; empty if it did."""


class OwnError(TypedDict):
    """Error of the run, estimated from the same scene on a coarser grid."""

    about: float | None
    """RMS error over Gaussians and frames, as a fraction of the object's size; null if it is
    unknown.
    """
    at_most: float | None
    """Upper bound of the error that `about` states."""
    until: float | None
    """Time from which the motion depends on the grid, so that `about` no longer holds [s]; null if
    it holds for the whole clip.
    """
    cells: int | None
    """Cells across the object on the coarser grid; null if the scene was not run on a coarser
    grid.
    """
    cost: float | None
    """Predicted time of the run on the coarser grid, as a fraction of the time of the dynamics."""
    why_not: str
    """Reason why the error is unknown."""


class Goal(TypedDict):
    """Result of `--max-error` or `--max-seconds`."""

    target: str
    """Maximum error or time that the user requested."""
    cells: int
    """Cells across the object in the chosen grid."""
    error: float | None
    """Estimated error in the unit of the request; null if it cannot be estimated."""
    unit: str
    """Unit of the error: fraction, pixels or metres."""
    fraction: float | None
    """Estimated error as a fraction of the object's size."""
    levels: list[int]
    """Cells across the object of each grid that was simulated."""
    errors: list[float]
    """Estimated error on each grid."""
    seconds: list[float]
    """Time of the run on each grid [s]."""
    order: float
    """Observed order of convergence."""
    refined: bool
    """Whether the search added a finer grid after the first estimate of the error."""
    met: bool
    """Whether the target is met."""
    why_not: str
    """Reason why the target is not met; empty if it is."""
    torn: list[int]
    """Cells across the object of the grids that were ignored because the material may have torn on
    them.
    """
    particles_per_axis: float
    """Number of particles per cell and axis."""


class Forecast(TypedDict):
    """Predicted and actual times of a run."""

    predicted: float
    """Predicted time [s]."""
    span: list[float]
    """Shortest and longest time that were expected [s]."""
    spent: float
    """Actual time [s]."""
    ratio: float
    """Actual time divided by predicted time."""
    stages: dict[str, Any]
    """Predicted and actual time of each stage."""
    substeps: int
    """Predicted number of substeps."""
    limiters: dict[str, int]
    """Name of a limit -> predicted number of substeps whose length this limit determines."""
    caveat: str | None
    """Reason why the prediction may be wrong."""


class Energy(TypedDict):
    """Energy balance of the run [J]."""

    turnover: float
    """Maximum over time of the energy at the start plus the energy supplied since then."""
    lost: float
    """Energy that was lost since the start; it is the sum of `material`, `contact` and
    `numerical`.
    """
    material: float
    """Energy lost to viscosity and plasticity inside the material."""
    contact: float
    """Energy lost to friction at walls; on lattices, energy lost in all contact."""
    numerical: float
    """Energy lost by the numerical method; negative if the method created energy."""
    kinetic: NotRequired[float]
    """Change of the kinetic energy. The keys `kinetic`, `forces` and `walls` are present for
    lattices and for liquids whose pressure is projected. `kinetic` plus `elastic` equals the sum of
    all work minus `lost`.
    """
    elastic: NotRequired[float]
    """Change of the elastic energy. This key and the following keys up to `unexplained` are present
    for lattices.
    """
    forces: NotRequired[float]
    """Work done by gravity and other forces."""
    walls: NotRequired[float]
    """Work done by the motion of walls."""
    held: NotRequired[float]
    """Work done by the motion of boundaries that hold a part of the object."""
    solids: NotRequired[float]
    """Work done by rigid solids that move freely, including friction at these solids."""
    stiffening: NotRequired[float]
    """Energy that changes of Young's modulus added."""
    friction: NotRequired[float]
    """Part of `contact`: energy lost to friction at walls."""
    impacts: NotRequired[float]
    """Part of `contact`: energy lost along the normals of walls, and where parts are seized."""
    pairs: NotRequired[float]
    """Part of `contact`: energy lost in contact between objects."""
    itself: NotRequired[float]
    """Part of `contact`: energy lost in contact between parts of the same object."""
    shock: NotRequired[float]
    """Part of `numerical`: energy lost to the artificial viscosity during fast compression."""
    substeps: NotRequired[float]
    """Part of `numerical`: elastic energy lost because substeps have a finite length."""
    unexplained: NotRequired[float]
    """Part of `numerical`: the sum of all work minus `kinetic`; this difference is a rounding
    error.
    """
    projection: NotRequired[float]
    """Part of `numerical`: energy lost in solving the pressure equation. This key and the following
    keys are present for liquids whose pressure is projected.
    """
    density: NotRequired[float]
    """Part of `numerical`: potential energy lost to the displacements that restore the density."""
    transfers: NotRequired[float]
    """Part of `numerical`: energy lost in the transfers between particles and grid."""


class Report(TypedDict):
    """All keys at the top level of the report."""

    complete: bool
    """Whether the simulation reached its end. If it did not, the valid frames were saved."""
    stopped: str | None
    """Reason why the simulation stopped early."""
    interrupted: bool
    """Whether Ctrl-C or SIGTERM ended the run; `--resume` can then continue it."""
    files: list[str]
    """Files and folders that the run wrote; the next run in this folder removes them."""
    remedies: list[dict[str, Any]]
    """Changes of the scene that would have prevented the stop, as field and value. Each single
    change suffices.
    """
    foreground: str | None
    """Method that cut the object out of the picture; null if there is no picture."""
    cutout: CutOut | None
    """Details of the cut-out; null if there is no picture."""
    generator: str | None
    """Name of the generator, or the file of Gaussians."""
    effort: NotRequired[dict[str, Any]]
    """Settings and predicted seconds of a slow generator, which takes minutes."""
    gaussians: int
    """Number of Gaussians."""
    grains: int
    """Number of additional Gaussians inside granular or torn material; they are hidden at the
    start."""
    particles: int
    """Number of particles."""
    frames: int
    """Number of frames."""
    substeps: int
    """Number of substeps."""
    mass: float
    """Mass of all particles [kg]."""
    thickness: float | None
    """Local thickness relative to the object's size; nine tenths of the object's volume are thicker
    than this value.
    """
    compliance: float | None
    """Deflection of the object, treated as a beam, if its weight acted sideways
    (docs/lab/own-error.md).
    """
    objects: NotRequired[dict[str, Any]]
    """Counts, mass [kg] and position [m] of each object, and poses of free rigid objects."""
    pairs: NotRequired[dict[str, Any]]
    """For each pair of objects: the largest force [N] and its time, and the last force and
    torque."""
    sources: NotRequired[dict[str, Any]]
    """For each further object from a picture or file: source, cut-out, generator and cleaning."""
    shapes: dict[str, Any]
    """Per constitutive law: the largest axis ratios of a Gaussian (`needle`, `axis_ratio`), and its
    `opacity`.

    If filming a long clip is cancelled or fails, only the filmed frames are included."""
    shine: dict[str, Any]
    """Per constitutive law: index ranges of the Gaussians that are drawn with gloss."""
    liquids: list[dict[str, Any]]
    """Per liquid: index ranges of the liquid's Gaussians (`runs`), and the liquid's `visibility`
    [m].
    """
    static: int
    """Number of Gaussians of static parts, which are not simulated."""
    sleep: dict[str, Any] | None
    """First frame in which the scene is at rest (`since`), number of `frames` at rest, and number
    of `substeps` that were skipped.
    """
    walls: dict[str, Any] | None
    """Largest and last force [N] and torque [N m] on each wall, if the run has `wrenches` or
    `contacts`."""
    cleaning: list[str]
    """Sentences about Gaussians that were dropped or repaired."""
    notes: list[str]
    """Sentences with further remarks about files, materials and the run."""
    unregistered: list[str]
    """Classes of the scene that only the program which made the run defines."""
    capture: NotRequired[dict[str, Any]]
    """For a capture: the rotation from the file's axes, and with `--floor` the detected floor."""
    playback: NotRequired[dict[str, Any]]
    """Pictures per second (`fps`), `speed` (1 is real time) and `seconds` of the videos."""
    departures: NotRequired[list[dict[str, Any]]]
    """Views in which the object leaves the picture, and the camera distance that would show all of
    it."""
    grid: dict[str, Any]
    """Cell width `dx` [m], and number of nodes in the grid's last `window`."""
    threads: int
    """Number of CPU threads. Runs with equal numbers of threads give equal results, bit for bit."""
    limiters: dict[str, int]
    """Name of a limit (elastic, speed, gradient, viscous or user) -> number of substeps whose
    length this limit determined.
    """
    substep: Substep
    """Length of the substeps."""
    balance: Balance
    """Results of the watchdog."""
    energy: NotRequired[Energy]
    """Energy balance of the run, if `checks.energy` is set."""
    effects: dict[str, Any]
    """Effects that were computed (`ran`), and effects that were not (`left_out`, with the reason
    and the saved seconds)."""
    error: NotRequired[OwnError]
    """The error of the run, estimated on the run's own scene."""
    promise: Promise
    """Upper bound of the clip's error."""
    forecast: NotRequired[Forecast]
    """Predicted and actual times, if `--forecast` is set."""
    goal: NotRequired[Goal]
    """Result of `--max-error` or `--max-seconds`."""
    stages: list[dict[str, Any]]
    """Name, seconds and kernel launches of each stage."""
    substep_stages: list[dict[str, Any]]
    """Name, seconds and kernel launches of each stage of a substep, on the main thread."""
    seconds: float
    """Wall time of the run [s]."""
    device: str
    """Device on which the simulation ran."""
    processor: str
    """Name of the machine's processor."""
    versions: dict[str, str]
    """Versions of phy124 and of the libraries that it uses for computing."""
