"""`phy124 render`: make videos of a saved clip, without simulating."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from phy124.commands.bars import Bars
from phy124.commands.options import Device, ViewOptions
from phy124.errors import Cancelled, InputError
from phy124.io.clip import Clip
from phy124.io.files import staging
from phy124.io.flaws import describe_flaws
from phy124.io.video import refuse_missing_encoder
from phy124.pipeline.run_folder import refuse_folders
from phy124.rendering.film import film, film_notes, name_files, refuse_missing_writers
from phy124.rendering.framing import describe_framing
from phy124.runtime.context import RunContext
from phy124.runtime.cores import refuse_threads
from phy124.runtime.device import pick_device
from phy124.runtime.installation import with_program
from phy124.runtime.light_imports import FILMING, import_lightly
from phy124.scene import Scene, View, merge_changes, parse_changes

if TYPE_CHECKING:
    from phy124.rendering.compose import Photograph


@dataclass(frozen=True)
class Render:
    """Make videos of a clip from other directions, in another size or in other formats."""

    clip: tyro.conf.Positional[Path]
    """clip.safetensors made by `phy124 generate`."""
    view: Annotated[ViewOptions, tyro.conf.arg(name="")] = field(default_factory=ViewOptions)
    set: tuple[str, ...] = field(default_factory=tuple)
    """Any other value of the view, as KEY=VALUE: elevation=30, background=[0,0,0]. The name in the
    scene is also accepted: view.elevation=30.
    """
    compose: Path | None = None
    """The photograph from which the clip was made, for a video of the object inside the photograph
    (composed.mp4).
    """
    out: Path | None = None
    """Folder for the videos; by default, the folder of the clip."""
    device: Device = "auto"
    threads: int | None = None
    """Number of CPU threads that render; by default, one per free core."""
    json: bool = False
    """Print only the names of the files, as JSON."""

    def run(self) -> int:
        """Render the clip; print the names of the written files."""
        refuse_threads(self.threads)
        import_lightly(*FILMING)
        clip = Clip.load(self.clip)
        changes = self.view.changes()
        others = _view_changes(parse_changes(self.set))
        view = (
            Scene.of_clip(clip.scene, str(self.clip)).replaced(merge_changes(changes, others)).view
        )
        out = self.out or self.clip.parent
        refuse_missing_writers(view)
        refuse_folders(out, name_files(view))
        photograph = self._photograph()
        with Bars(quiet=self.json, keeps=True) as bars, staging(out, keeps=True) as folder:
            with suppress(Cancelled):
                device = pick_device(self.device)
                context = RunContext(device=device, threads=self.threads, progress=bars)
                film(clip, view, folder, context)
                if photograph is not None:
                    from phy124.rendering.compose import compose

                    compose(clip, view, photograph, folder, context)
            files = [str(out / path.name) for path in sorted(folder.iterdir())]
            if bars.cancelled and not files:
                raise Cancelled
        notes = [
            *describe_flaws(clip),
            *describe_framing(clip, view)["notes"],
            *film_notes(clip, view),
        ]
        if self.json:
            print(json.dumps({"files": files, "notes": notes}))
        else:
            print("\n".join([*files, *(f"note: {note}" for note in notes)]))
        return bars.status("the listed files are complete, and the others were not written")

    def _photograph(self) -> Photograph | None:
        if self.compose is None:
            return None
        from phy124.rendering.compose import photograph_of

        refuse_missing_encoder()
        return photograph_of(self.compose, self.clip.parent)


def _view_changes(changes: dict[str, Any]) -> dict[str, Any]:
    for key, value in changes.items():
        field_name = key.partition(".")[0]
        if field_name in Scene.model_fields and field_name not in {"view", *View.model_fields}:
            limit = "It is a setting of the simulation, which `render` does not repeat."
            remedy = f"Add `--set {key}=...` to `phy124 generate` or `phy124 simulate`."
            raise InputError(key, value, limit, with_program(remedy))
    return {f"view.{key.removeprefix('view.')}": value for key, value in changes.items()}
