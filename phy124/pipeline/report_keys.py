"""Declares the keys of report.json; every run writes this file and also stores it in the clip.

A `NotRequired` key is present only if a run uses the option named in the key's description. An
observer that a user adds may add keys. If a release removes a key, the changelog names it.
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
    """Fraction of the object's outline that lies on the edge of the picture."""
    alike: float
    """Fraction of the background whose colours are similar to the object's."""
    undecided: float
    """Fraction of the pixels that are half transparent but not near the outline."""
    frames: int
    """Number of frames, if the picture is an animation; only the first frame is used."""
    objects: int
    """Number of separate objects that were detected in the picture."""
    touching: bool
    """Whether the cut-out may contain two objects that touch each other."""
    warnings: list[str]
    """Reasons why the cut-out may be wrong."""
    notes: list[str]
    """Sentences about parts of the picture file that were ignored."""


class Substep(TypedDict):
    """Length of the substeps."""

    mean: float
    """Mean length of the substeps [s]."""
    asked: float | None
    """`time.substep` of the scene [s]; null if the scene sets none."""
    split: bool
    """Whether the substeps are shorter than the value of `asked`."""
    fractions: dict[str, float]
    """For each stability limit, the fraction of the substeps whose length this limit determined."""
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
    """Number of particles that separated from the rest of their piece of material."""
    likely: bool
    """Whether the grid probably tore the material."""


class Balance(TypedDict):
    """Results of the watchdog."""

    energy_gain: float | None
    """Energy created by numerical errors, minus all energy that was lost, as a fraction of the
    supplied energy. The losses include friction, viscosity and plastic deformation, so a negative
    value is not necessarily an error; `checks.energy` divides the losses by cause. The value is
    null if the energy balance was not computed.
    """
    momentum_gain: float | None
    """Momentum created by numerical errors, as a fraction of the exchanged momentum; null if the
    momentum balance was not computed.
    """
    min_J: float
    """Smallest elastic volume ratio J of all particles. The permanent change of the volume of snow
    and sand, which pack and loosen, is not part of J.
    """
    max_J: float
    """Largest elastic volume ratio J of all particles."""
    inside_out: int
    """Number of inverted particles."""
    reset: int
    """Number of deformation gradients that were reset to the rest shape."""
    ballistic: int
    """Number of particles outside the simulated space; gravity is the only force on them."""
    tearing: NotRequired[Tearing]
    """Signs that the grid has torn the material (numerical fracture). The key is absent if bodies
    are on lattices.
    """


class Promise(TypedDict):
    """Error bound of the clip; docs/results/accuracy.md explains it."""

    error: float | None
    """Upper bound of the error, as a fraction of the object's size. The value is null if no similar
    scene was measured, if the material tore, or if the run stopped early.
    """
    why: str
    """Sentence that explains how `error` was obtained, or why it is null."""
    unmeasured: str
    """Kind of the scene, if no scene of this kind was measured and `error` is therefore null."""
    about: float | None
    """Error estimated from this scene, relative to the object's size; null: no estimate."""
    seconds: float | None
    """Time up to which the bound holds [s]; null if the bound holds for the whole clip."""
    unestimated: str
    """Reason why the run did not estimate its error; empty if the error was estimated."""


class OwnError(TypedDict):
    """Error of the run, estimated from the same scene on a coarser grid."""

    about: float | None
    """RMS error over Gaussians and frames, relative to the object's size; null: unknown."""
    at_most: float | None
    """Upper bound of the error."""
    until: float | None
    """Time after which `about` no longer holds, because the motion depends on the grid [s]; null if
    it holds for the whole clip.
    """
    cells: int | None
    """Cells across the object on the coarser grid; null if the scene was not run on one."""
    cost: float | None
    """Predicted time of the run on the coarser grid, as a fraction of the simulation's time."""
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
    """Number of cells across the object for each simulated grid."""
    errors: list[float]
    """Estimated error for each simulated grid."""
    seconds: list[float]
    """Time of the run on each grid [s]."""
    order: float
    """Measured order of convergence."""
    refined: bool
    """Whether a finer grid was added after the first estimate of the error."""
    met: bool
    """Whether the target is met."""
    why_not: str
    """Reason why the target is not met; empty if the target is met."""
    torn: list[int]
    """Cells across the object for grids that were ignored because the material may have torn."""
    stopped: list[int]
    """Cells across the object for coarse grids that were ignored because the run stopped early."""
    particles_per_axis: float
    """Number of particles per cell and axis."""


class Forecast(TypedDict):
    """Predicted and actual times of a run."""

    predicted: float
    """Predicted time [s]."""
    span: list[float]
    """Lower and upper limit of the predicted time [s]."""
    spent: float
    """Actual time [s]."""
    ratio: float
    """Actual time divided by predicted time."""
    stages: dict[str, Any]
    """Predicted and actual time of each stage."""
    substeps: int
    """Predicted number of substeps."""
    limiters: dict[str, int]
    """For each stability limit, the predicted number of substeps whose length this limit
    determines."""
    caveat: str | None
    """Reason why the prediction may be wrong."""


class Energy(TypedDict):
    """Energy balance of the run [J]."""

    turnover: float
    """Energy at the start plus the energy supplied since the start; the maximum over time."""
    lost: float
    """Energy lost since the start: the sum of `material`, `contact` and `numerical`."""
    material: float
    """Energy lost to viscosity and plasticity inside the material."""
    contact: float
    """Energy lost to friction at walls; on lattices, energy lost in all contact."""
    numerical: float
    """Energy lost by the numerical method; negative if the method created energy."""
    kinetic: NotRequired[float]
    """Change of the kinetic energy. The keys `kinetic`, `forces` and `walls` are present for
    lattices and for liquids with projected pressure. `kinetic` plus `elastic` equals the sum of all
    work (`forces`,
    `walls`, `held`, `solids` and `stiffening`) minus `lost`.
    """
    elastic: NotRequired[float]
    """Change of the elastic energy. For lattices, the keys from `elastic` to `unexplained` are
    present. For liquids with bodies, only `elastic`, `solids`, `stiffening` and `shock` of these
    keys are present.
    """
    forces: NotRequired[float]
    """Work done by gravity and other forces."""
    walls: NotRequired[float]
    """Work done by the motion of walls; in liquids with bodies, also by clamps. If walls move,
    their work on bodies made of particles includes friction.
    """
    held: NotRequired[float]
    """Work done by the motion of boundaries that hold a part of the object."""
    solids: NotRequired[float]
    """Work done by rigid solids that move freely, including friction at these solids."""
    stiffening: NotRequired[float]
    """Energy added by changes of Young's modulus."""
    friction: NotRequired[float]
    """Part of `contact`: energy lost to friction at walls."""
    impacts: NotRequired[float]
    """Part of `contact`: energy lost in normal impacts on walls, and when parts are gripped."""
    pairs: NotRequired[float]
    """Part of `contact`: energy lost in contact between objects."""
    itself: NotRequired[float]
    """Part of `contact`: energy lost in contact between parts of the same object."""
    shock: NotRequired[float]
    """Part of `numerical`: energy lost to the artificial viscosity during fast compression."""
    substeps: NotRequired[float]
    """Part of `numerical`: elastic energy lost because substeps have a finite length."""
    unexplained: NotRequired[float]
    """Part of `numerical`: the rounding error of the energy balance."""
    exchange: NotRequired[dict[str, float]]
    """Work of the liquid's pressure on each body and each free solid. The liquid and the walls
    supply the energy for this work. The key is present for liquids with bodies.
    """
    projection: NotRequired[float]
    """Part of `numerical`: energy lost in solving the pressure equation, and in passing its
    pressure to bodies; negative if energy was created. The keys from `projection` to `transfers`
    are present for liquids with projected pressure.
    """
    density: NotRequired[float]
    """Part of `numerical`: potential energy lost to the displacements that restore the density and
    move particles out of bodies.
    """
    transfers: NotRequired[float]
    """Part of `numerical`: energy lost in the transfers between particles and grid. In liquids with
    bodies, this also includes the errors of finite substeps, and the contact between bodies made of
    particles.
    """


class Report(TypedDict):
    """All keys at the top level of the report."""

    complete: bool
    """Whether the simulation reached its end; otherwise, the valid frames were saved."""
    stopped: str | None
    """Reason why the simulation stopped early."""
    interrupted: bool
    """Whether Ctrl-C or SIGTERM ended the run; such a run can be continued with `--resume`."""
    files: list[str]
    """Files and folders that the run wrote; the next run in the same folder removes these files."""
    remedies: list[dict[str, Any]]
    """Changes of the scene (field and value), each of which would have prevented the stop."""
    foreground: str | None
    """Method that cut the object out of the picture; null if there is no picture."""
    cutout: CutOut | None
    """Details of the cut-out; null if there is no picture."""
    crop: list[float]
    """Left, top, right and bottom of the first object in its picture, as fractions of the width and
    height. Painted masks and stiffness pictures refer to this picture.
    """
    generator: str | None
    """Name of the generator, or the file of Gaussians."""
    inputs: NotRequired[dict[str, str]]
    """Options that determine the objects, and SHA-256 digests of the files from which the command
    made them; `--resume` refuses others."""
    effort: NotRequired[dict[str, Any]]
    """Settings and predicted time [s] of a slow generator."""
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
    """Local thickness, relative to the object's size. Nine tenths of the object's volume are
    thicker than this value.
    """
    compliance: float | None
    """Deflection of the object, modelled as a beam under its weight (docs/lab/own-error.md)."""
    pieces: int | None
    """Number of separate pieces of the object; None: all objects are scenery."""
    objects: NotRequired[dict[str, Any]]
    """Counts, mass [kg] and position [m] of each object, and poses of free rigid objects."""
    pairs: NotRequired[dict[str, Any]]
    """For each pair of objects: the largest force [N] and its time, and the last force and
    torque."""
    sources: NotRequired[dict[str, Any]]
    """For each further object from a picture or file: source, cut-out, generator and cleaning."""
    shapes: dict[str, Any]
    """For each constitutive law: largest axis ratios of a Gaussian (`needle`, `axis_ratio`), and
    its `opacity`.

    If rendering a long clip is cancelled or fails, only the rendered frames count."""
    shine: dict[str, Any]
    """For each constitutive law: index ranges of the Gaussians that are drawn with gloss."""
    liquids: list[dict[str, Any]]
    """For each liquid: index ranges of the liquid's Gaussians (`runs`), the volume of a Gaussian in
    each range (`volumes`) [m^3], and the liquid's `visibility` [m] and `viscosity` [Pa s].
    """
    matte: list[dict[str, Any]]
    """For each tinted granular material: index ranges of the Gaussians that a lamp lights
    (`runs`), and the volume of a Gaussian in each range (`volumes`) [m^3]."""
    dents: list[list[list[int]]]
    """For each solid that keeps dents and has no gloss: index ranges of its Gaussians, whose light
    follows the shape."""
    fragments: list[list[list[int]]]
    """For each material that crumbles: index ranges of its Gaussians, which are drawn as fragments
    where the material is broken."""
    static: int
    """Number of Gaussians of static parts, which are not simulated."""
    sleep: dict[str, Any] | None
    """First frame at rest (`since`), `frames` at rest, and number of skipped `substeps`."""
    walls: dict[str, Any] | None
    """Largest and last force [N] and torque [N m] on each wall, with `wrenches` or `contacts`."""
    cleaning: list[str]
    """Sentences about Gaussians that were removed or repaired."""
    notes: list[str]
    """Sentences with further remarks about files, materials and the run."""
    unregistered: list[str]
    """Classes of the scene that are defined only by the program that made the run."""
    capture: NotRequired[dict[str, Any]]
    """For a file: `rotation`, `scale` and `shift` that map the file's coordinates to those of the
    upright object; `placement` maps them to the first frame [m]; with `--floor`, also the detected
    floor.
    """
    playback: NotRequired[dict[str, Any]]
    """Pictures per second (`fps`), `speed` (1 is real time) and `seconds` of the videos."""
    departures: NotRequired[list[dict[str, Any]]]
    """Views in which the object leaves the picture, and the camera distance that would avoid it."""
    grid: dict[str, Any]
    """Width `dx` of a grid cell [m], and number of nodes in the last `window`, which is the part of
    the grid that is stored."""
    threads: int
    """Number of CPU threads. Runs with the same number of threads are equal bit for bit."""
    limiters: dict[str, int]
    """For each limit (elastic, speed, gradient, viscous, user, retry), the number of substeps whose
    length it determined. The limit `user` is time.substep, and `retry` is half the substep of a
    first attempt that failed.
    """
    substep: Substep
    """Length of the substeps."""
    balance: Balance
    """Results of the watchdog."""
    energy: NotRequired[Energy]
    """Energy balance of the run, if `checks.energy` is set."""
    effects: dict[str, Any]
    """Effects that were computed (`ran`) and that were not computed (`left_out`).

    Each entry of `left_out` states the reason and the time saved [s].
    """
    error: NotRequired[OwnError]
    """Error of the run, estimated from the same scene on a coarser grid."""
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
    """Versions of phy124 and of its numerical libraries."""
