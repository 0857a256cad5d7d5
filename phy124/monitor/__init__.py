"""Observers of a run, one per file; `OBSERVERS` lists all observers."""

from phy124.monitor.contacts import Contacts
from phy124.monitor.coupled import (
    CoupledContacts,
    CoupledPairs,
    CoupledWatchdog,
    CoupledWork,
    CoupledWrenches,
)
from phy124.monitor.crossing import LatticeCrossing
from phy124.monitor.dissipation import Dissipation
from phy124.monitor.external_work import ExternalWork
from phy124.monitor.immersed import ImmersedPairs, ImmersedWork, ImmersedWrenches
from phy124.monitor.interior import Interior
from phy124.monitor.lattice import (
    LatticeContacts,
    LatticeMethod,
    LatticePairs,
    LatticeSelfContact,
    LatticeShock,
    LatticeWatchdog,
    LatticeWork,
    LatticeWrenches,
)
from phy124.monitor.lattice_dissipation import LatticeDissipation
from phy124.monitor.liquid import LiquidDissipation
from phy124.monitor.liquid_work import LiquidWork
from phy124.monitor.observer import Observer
from phy124.monitor.pool_dissipation import ImmersedDissipation, MixedDissipation, PoolDissipation
from phy124.monitor.pool_work import MixedWork
from phy124.monitor.sleep import Sleep
from phy124.monitor.softening import Softening
from phy124.monitor.speeds import Speeds
from phy124.monitor.tearing import Tearing
from phy124.monitor.watchdog import Watchdog
from phy124.monitor.wrenches import Wrenches
from phy124.scene import Scene

OBSERVERS: tuple[type[Observer], ...] = (
    Softening,
    Wrenches,
    Contacts,
    ExternalWork,
    Dissipation,
    LiquidDissipation,
    Watchdog,
    Speeds,
    Tearing,
    Interior,
    Sleep,
)
"""All observers, in the order in which a run calls them.

Each observer adds its stages around the stages of the observers before it in this list.
`ExternalWork` therefore measures all walls together. `Tearing` comes after `Watchdog`. `Tearing`
therefore reads only valid frames, since an error that `Watchdog` finds ends the attempt.
"""


def _replace(changes: dict[type[Observer], type[Observer]]) -> tuple[type[Observer], ...]:
    return tuple(changes.get(observer, observer) for observer in OBSERVERS)


LIQUID_OBSERVERS = _replace({ExternalWork: LiquidWork})
"""Observers of a liquid with projected pressure, without other bodies."""
POOL_OBSERVERS = _replace({ExternalWork: LiquidWork, LiquidDissipation: PoolDissipation})
"""Observers of a liquid with projected pressure that contains only freely moving solids."""
MIXED_OBSERVERS = _replace({ExternalWork: MixedWork, LiquidDissipation: MixedDissipation})
"""Observers of a liquid with projected pressure and particle bodies."""
LATTICE_OBSERVERS: tuple[type[Observer], ...] = (
    LatticeMethod,
    LatticePairs,
    LatticeSelfContact,
    LatticeShock,
    Softening,
    LatticeWrenches,
    LatticeContacts,
    LatticeWork,
    LatticeDissipation,
    LatticeWatchdog,
    Speeds,
    LatticeCrossing,
    Sleep,
)
"""Observers of bodies on lattices, which cannot tear."""
COUPLED_OBSERVERS: tuple[type[Observer], ...] = (
    CoupledPairs,
    LatticeSelfContact,
    LatticeShock,
    CoupledWrenches,
    CoupledContacts,
    CoupledWork,
    CoupledWatchdog,
    Speeds,
)
"""Observers of bodies on lattices together with particle bodies."""
IMMERSED_OBSERVERS: tuple[type[Observer], ...] = (
    ImmersedPairs,
    LatticeSelfContact,
    LatticeShock,
    Softening,
    ImmersedWrenches,
    ImmersedWork,
    ImmersedDissipation,
    CoupledWatchdog,
    Speeds,
)
"""Observers of bodies on lattices in a liquid with projected pressure."""


def observers_for(scene: Scene) -> tuple[type[Observer], ...]:
    """Return the observers for the solver of a scene."""
    if scene.immerses:
        return IMMERSED_OBSERVERS
    if scene.couples:
        return COUPLED_OBSERVERS
    if scene.projects:
        if scene.mixes:
            return MIXED_OBSERVERS
        free = any(item.free for item in scene.objects)
        return POOL_OBSERVERS if free else LIQUID_OBSERVERS
    return LATTICE_OBSERVERS if scene.on_lattice else OBSERVERS
