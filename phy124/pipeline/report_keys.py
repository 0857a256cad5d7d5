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
    """Fraction of pixels that are half transparent although they are away from the outline."""
    frames: int
    """Number of frames of an animation; the first frame is used."""
    objects: int
    """Number of separate objects detected."""
    touching: bool
    """Whether the object may consist of two objects that touch."""
    warnings: list[str]
    """Reasons to doubt the cut-out."""
    notes: list[str]
    """Parts of the picture's file that were ignored."""


class Substep(TypedDict):
    """Length of the substeps."""

    mean: float
    """Mean length [s]."""
    asked: float | None
    """`time.substep` of the scene [s]; null if the scene sets none."""
    split: bool
    """Whether the substeps are shorter than `asked`."""
    fractions: dict[str, float]
    """Fraction of the substeps that each limit determined."""
    rejected: int
    """Number of substeps that were repeated with a shorter length."""
    retried: list[int]
    """Frames that were computed again with shorter substeps."""


class Tearing(TypedDict):
    """Elastic particles that may have lost contact with each other."""

    apart: int
    """Largest number of particles in a frame that are stretched apart."""
    stretch: float
    """Largest stretch of these particles."""
    loose: int
    """Number of particles that separated from the rest of their piece."""
    likely: bool
    """Whether the grid probably tore the material."""


class Balance(TypedDict):
    """Results of the watchdog."""

    energy_gain: float | None
    """Spurious energy as a fraction of the supplied energy; negative if energy was lost, null if no
    balance was made."""
    momentum_gain: float | None
    """Spurious momentum as a fraction of the exchanged momentum; null if no balance was made."""
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
    """Signs of numerical fracture."""


class Promise(TypedDict):
    """Error bound of the clip; docs/results/accuracy.md explains it."""

    error: float | None
    """Upper bound as a fraction of the object's size; null if not measured, torn or stopped."""
    why: str
    """Sentence that gives the reason for the value, or for null."""
    unmeasured: str
    """Kind of scene for which no error was measured, if `error` is null for this reason."""
    about: float | None
    """Error that was estimated on this scene itself, as a fraction of the size; otherwise null."""
    seconds: float | None
    """Time up to which the bound holds [s]; null if it holds for the whole clip."""
    unestimated: str
    """Reason why the run did not estimate its own error; empty if it did."""


class OwnError(TypedDict):
    """Error of the run, estimated from the same scene on a coarser grid."""

    about: float | None
    """RMS error over Gaussians and frames, as a fraction of the object's size; null: unknown."""
    at_most: float | None
    """Bound on this error."""
    until: float | None
    """Time from which the motion depends on the grid and `about` no longer holds [s]; null if it
    never does."""
    cells: int | None
    """Cells across the object on the coarser grid; null if there was no run on it."""
    cost: float | None
    """Predicted time of the run on the coarser grid, as a fraction of the time of the dynamics."""
    why_not: str
    """Reason why the error is unknown."""


class Goal(TypedDict):
    """Result of `--max-error` or `--max-seconds`."""

    target: str
    """Requested error or time."""
    cells: int
    """Cells across the object in the chosen grid."""
    error: float | None
    """Estimated error in the unit of the target; null if it cannot be estimated."""
    unit: str
    """fraction, pixels or metres."""
    fraction: float | None
    """Estimated error as a fraction of the object's size."""
    levels: list[int]
    """Cells across the object of each grid that was simulated."""
    errors: list[float]
    """Estimated error of each grid."""
    seconds: list[float]
    """Time of the run on each grid [s]."""
    order: float
    """Observed order of convergence."""
    refined: bool
    """Whether the search added a finer grid after the first estimate."""
    met: bool
    """Whether the target is met."""
    why_not: str
    """Reason why the target is not met; empty if it is."""
    torn: list[int]
    """Cells across the object of grids that were left out because the material may have torn on
    them."""
    particles_per_axis: float
    """Particles per cell and axis."""


class Forecast(TypedDict):
    """Predicted and actual times of a run."""

    predicted: float
    """Predicted time [s]."""
    span: list[float]
    """Lowest and highest time that were expected [s]."""
    spent: float
    """Actual time [s]."""
    ratio: float
    """Actual time divided by predicted time."""
    stages: dict[str, Any]
    """Predicted and actual time of each stage."""
    substeps: int
    """Predicted number of substeps."""
    limiters: dict[str, int]
    """Predicted number of substeps whose length each limit determines."""
    caveat: str | None
    """Reason why the prediction may be wrong."""


class Energy(TypedDict):
    """Energy balance [J]."""

    turnover: float
    """Largest value over time of: energy at the start plus energy supplied since."""
    lost: float
    """Energy that was lost since the start; the sum of `material`, `contact` and `numerical`."""
    material: float
    """Loss by viscosity and plasticity inside the material."""
    contact: float
    """Loss by friction at walls; on lattices, loss by all contact."""
    numerical: float
    """Other losses, which the numerical method causes; negative if energy was gained."""
    kinetic: NotRequired[float]
    """Change of the kinetic energy. This key, `forces` and `walls` are for lattices and for liquids
    by pressure projection. `kinetic` plus `elastic` is the sum of all works minus `lost`.
    """
    elastic: NotRequired[float]
    """Change of the elastic energy; this key and the following ones up to `unexplained` are for
    lattices.
    """
    forces: NotRequired[float]
    """Work of gravity and other forces."""
    walls: NotRequired[float]
    """Work of walls by their motion."""
    held: NotRequired[float]
    """Work of boundaries that hold a part of the object, by their motion."""
    solids: NotRequired[float]
    """Work of free solids, including their friction."""
    stiffening: NotRequired[float]
    """Energy received by changes of Young's modulus."""
    friction: NotRequired[float]
    """Part of `contact`: loss by friction at walls."""
    impacts: NotRequired[float]
    """Part of `contact`: loss along the normals of walls, and where parts are seized."""
    pairs: NotRequired[float]
    """Part of `contact`: loss between objects."""
    itself: NotRequired[float]
    """Part of `contact`: loss between parts of an object."""
    shock: NotRequired[float]
    """Part of `numerical`: loss by the artificial viscosity in fast compression."""
    substeps: NotRequired[float]
    """Part of `numerical`: elastic energy lost because substeps have a finite length."""
    unexplained: NotRequired[float]
    """Part of `numerical`: the sum of all works minus `kinetic`, which is a rounding error."""
    projection: NotRequired[float]
    """Part of `numerical`: loss by the pressure equation; this key and the following ones are for
    projected liquids.
    """
    density: NotRequired[float]
    """Part of `numerical`: potential energy lost to the displacements that restore the density."""
    transfers: NotRequired[float]
    """Part of `numerical`: loss by the transfers between particles and grid."""


class Report(TypedDict):
    """The keys of the report."""

    complete: bool
    """Whether the simulation reached its end; otherwise its valid frames were saved."""
    stopped: str | None
    """Reason why the simulation stopped early."""
    interrupted: bool
    """Whether Ctrl-C or SIGTERM ended the run, which `--resume` then continues."""
    files: list[str]
    """Files and folders that the run wrote; the next run in this folder removes them."""
    remedies: list[dict[str, Any]]
    """Changes of the scene that would have prevented the stop, as field and value; each one
    suffices."""
    foreground: str | None
    """Method that cut the object out; null without a picture."""
    cutout: CutOut | None
    """Details of the cut-out; null without a picture."""
    generator: str | None
    """Name of the generator, or the file of Gaussians."""
    effort: NotRequired[dict[str, Any]]
    """Settings and predicted seconds of a generator that takes minutes."""
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
    """Local thickness relative to the object's size; nine tenths of the object's
    volume are thicker."""
    compliance: float | None
    """Deflection of the object as a beam if its weight acts sideways (docs/lab/own-error.md)."""
    objects: NotRequired[dict[str, Any]]
    """Counts, mass [kg] and position [m] of each object, and poses of free rigid objects."""
    pairs: NotRequired[dict[str, Any]]
    """For each pair of objects: the largest force [N] and its time, and the last force and
    torque."""
    sources: NotRequired[dict[str, Any]]
    """For each further object from a picture or file: source, cut-out, generator and cleaning."""
    shapes: dict[str, Any]
    """Per law: the largest axis ratios of a Gaussian (`needle`, `axis_ratio`), and its `opacity`.

    If filming a long clip is cancelled or fails, only frames that were filmed count."""
    shine: dict[str, Any]
    """Per law: index ranges of the Gaussians that are drawn with gloss."""
    liquids: list[dict[str, Any]]
    """Per liquid: index ranges of its Gaussians (`runs`), and its `visibility` [m]."""
    static: int
    """Number of Gaussians of static parts, which are not simulated."""
    sleep: dict[str, Any] | None
    """Frame from which the scene is at rest (`since`), number of `frames` at rest, and number of
    `substeps` that were saved."""
    walls: dict[str, Any] | None
    """Largest and last force [N] and torque [N m] on each wall, if the run has `wrenches` or
    `contacts`."""
    cleaning: list[str]
    """Gaussians that were dropped or repaired, as sentences."""
    notes: list[str]
    """Further remarks about files, materials and the run, as sentences."""
    unregistered: list[str]
    """Classes that the scene uses although only the program that made the run defines them."""
    capture: NotRequired[dict[str, Any]]
    """For a capture: the rotation from the file's axes, and with `--floor` the detected floor."""
    playback: NotRequired[dict[str, Any]]
    """Pictures per second (`fps`), `speed` (1 is real time) and `seconds` of the videos."""
    departures: NotRequired[list[dict[str, Any]]]
    """Views in which the object leaves the picture, and the camera distance that would show all of
    it."""
    grid: dict[str, Any]
    """Cell width `dx` [m] and number of nodes of the last `window`."""
    threads: int
    """Number of CPU threads; runs with the same number give the same result, bit for bit."""
    limiters: dict[str, int]
    """Number of substeps whose length each limit determined: elastic, speed, gradient, viscous,
    user."""
    substep: Substep
    """Length of the substeps."""
    balance: Balance
    """Results of the watchdog."""
    energy: NotRequired[Energy]
    """Energy balance, with `checks.energy`."""
    effects: dict[str, Any]
    """Effects that were computed (`ran`), and effects that were not (`left_out`, with the reason
    and the saved seconds)."""
    error: NotRequired[OwnError]
    """The run's own error."""
    promise: Promise
    """Error bound of the clip."""
    forecast: NotRequired[Forecast]
    """Predicted and actual times, with `--forecast`."""
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
    """Processor of the machine."""
    versions: dict[str, str]
    """Versions of phy124 and of the libraries that it uses for computing."""
