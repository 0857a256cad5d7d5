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
from phy124.monitor.external_work import ExternalWork, MeanWork
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
from phy124.monitor.observer import Observer
from phy124.monitor.pool_work import PoolWork
from phy124.monitor.sleep import Sleep
from phy124.monitor.softening import Softening
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
    Tearing,
    Interior,
    Sleep,
)
"""All observers, in the order in which a run calls them.

Each observer wraps the stages that earlier observers return. `ExternalWork` therefore measures all
walls together, around the measurements of single walls. An error ends an attempt, so `Tearing`
reads only valid frames.
"""
LIQUID_OBSERVERS: tuple[type[Observer], ...] = tuple(
    MeanWork if observer is ExternalWork else observer for observer in OBSERVERS
)
"""Observers of a projected liquid without other bodies."""
MIXED_OBSERVERS: tuple[type[Observer], ...] = tuple(
    PoolWork if observer is ExternalWork else observer for observer in OBSERVERS
)
"""Observers of a projected liquid that contains particle bodies."""
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
    LatticeCrossing,
    Sleep,
)
"""Observers of bodies on lattices; there is no `Tearing`, since lattices cannot tear."""
COUPLED_OBSERVERS: tuple[type[Observer], ...] = (
    CoupledPairs,
    LatticeSelfContact,
    LatticeShock,
    CoupledWrenches,
    CoupledContacts,
    CoupledWork,
    CoupledWatchdog,
)
"""Observers of runs with both bodies on lattices and particle bodies."""
IMMERSED_OBSERVERS: tuple[type[Observer], ...] = (
    ImmersedPairs,
    LatticeSelfContact,
    LatticeShock,
    Softening,
    ImmersedWrenches,
    ImmersedWork,
    CoupledWatchdog,
)
"""Observers of runs with bodies on lattices in a projected liquid."""


def observers_for(scene: Scene) -> tuple[type[Observer], ...]:
    """Return the observers for a scene's solver."""
    if scene.immerses:
        return IMMERSED_OBSERVERS
    if scene.couples:
        return COUPLED_OBSERVERS
    if scene.projects:
        return MIXED_OBSERVERS if scene.mixes else LIQUID_OBSERVERS
    return LATTICE_OBSERVERS if scene.on_lattice else OBSERVERS
