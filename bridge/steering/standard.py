"""Standard services of simulators (simulation_interfaces 1.x and 2.x) for a steered run."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from phy124.errors import InputError

from ..options import Options
from ..topics import Service
from .entities import Code, Entities, result
from .run import State, SteeredRun

PACKAGE = "simulation_interfaces"


class Feature(IntEnum):
    """Features of `simulation_interfaces/msg/SimulatorFeatures` that a run supports."""

    ENTITY_BOUNDS_BOX = 6
    ENTITY_CATEGORIES = 8
    ENTITY_STATE_GETTING = 10
    ENTITY_STATE_SETTING = 11
    ENTITY_INFO_GETTING = 12
    SIMULATION_RESET = 20
    SIMULATION_RESET_TIME = 21
    SIMULATION_RESET_STATE = 22
    SIMULATION_STATE_GETTING = 24
    SIMULATION_STATE_SETTING = 25
    SIMULATION_STATE_PAUSE = 26
    STEP_SIMULATION_SINGLE = 31
    STEP_SIMULATION_MULTIPLE = 32
    STEP_SIMULATION_ACTION = 33


SCOPE_TIME, SCOPE_STATE = 1, 2
"""Bits of the field `scope` of a request to ResetSimulation."""
EVERYTHING = (0, 255)
"""Scopes that reset both the time and the state: SCOPE_DEFAULT and SCOPE_ALL."""


class Standard:
    """The standard services of a run."""

    def __init__(self, run: SteeredRun, options: Options, *, action: bool) -> None:
        """Store the run; if `action` is set, peers can also step by a ROS action."""
        self._run, self._action = run, action
        self._entities = Entities(run, options)

    @property
    def services(self) -> tuple[Service, ...]:
        """All services that a steered run offers, with their names, types and functions."""
        served = {
            "GetSimulatorFeatures": ("get_simulator_features", self.features),
            "GetSimulationState": ("get_simulation_state", self.state),
            "SetSimulationState": ("set_simulation_state", self.set_state),
            "StepSimulation": ("step_simulation", self.step),
            "ResetSimulation": ("reset_simulation", self.reset),
            "GetEntities": ("get_entities", self._entities.list),
            "GetEntityInfo": ("get_entity_info", self._entities.info),
            "GetEntityState": ("get_entity_state", self._entities.state),
            "SetEntityState": ("set_entity_state", self._entities.set_state),
            "SpawnEntity": ("spawn_entity", self._entities.spawn),
            "DeleteEntity": ("delete_entity", self._entities.delete),
        }
        return tuple(
            Service(f"~/{name}", f"{PACKAGE}/srv/{kind}", serve)
            for kind, (name, serve) in served.items()
        )

    def features(self, request: Any) -> dict[str, Any]:
        """List the supported features."""
        del request
        left_out = () if self._action else (Feature.STEP_SIMULATION_ACTION,)
        features = [int(feature) for feature in Feature if feature not in left_out]
        text = "phy124: deformable objects; ~/push, ~/grab (docs/guide/steering.md)"
        return {"features": {"features": features, "spawn_formats": [], "custom_info": text}}

    def state(self, request: Any) -> dict[str, Any]:
        """Return the state of the run."""
        del request
        return {"state": {"state": int(self._run.state)}, "result": result(Code.OK)}

    def set_state(self, request: Any) -> dict[str, Any]:
        """Play, pause, stop (and reset), or quit the run."""
        wanted = request.state.state
        if wanted not in tuple(State):
            said = (
                f"There is no state {wanted}; the states are 0 stopped, "
                "1 playing, 2 paused, 3 quitting."
            )
            return {"result": result(Code.FEATURE_UNSUPPORTED, said)}
        if self._run.state == wanted:
            return {
                "result": result(
                    Code.ALREADY_IN_TARGET_STATE, "The run is already in the requested state."
                )
            }
        self._run.enter(State(wanted))
        return {"result": result(Code.OK)}

    def step(self, request: Any) -> dict[str, Any]:
        """Compute steps while the run is paused."""
        try:
            for _ in self._run.steps(request.steps):
                pass
        except InputError as error:
            return {"result": result(Code.OPERATION_FAILED, str(error))}
        return {"result": result(Code.OK)}

    def reset(self, request: Any) -> dict[str, Any]:
        """Reset the time, the object, or both."""
        scope = request.scope
        everything = scope in EVERYTHING
        if not everything and scope & ~(SCOPE_TIME | SCOPE_STATE):
            said = f"The scopes are time (1), state (2), both (3) or all (255), not {scope}."
            return {"result": result(Code.FEATURE_UNSUPPORTED, said)}
        self._run.reset(
            time=everything or bool(scope & SCOPE_TIME),
            state=everything or bool(scope & SCOPE_STATE),
        )
        return {"result": result(Code.OK)}
