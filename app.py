"""The hosted page: `python app.py`, or a Hugging Face Space as it stands (docs/guide/web.md)."""

import sys
import threading

from demo.folder import own_folder
from demo.server import end_on_signals, launch, prepare
from demo.settings import Settings
from phy124.errors import InputError


def main() -> None:
    """Serve the page until interrupted."""
    settings = Settings.from_environment()
    end_on_signals()
    with own_folder(settings.folder) as root:
        prepare(settings, root)
        from demo.ui import STYLE, build, open_studio, theme

        studio = open_studio(settings, root)
        threading.Thread(target=studio.warm_up, name="warm-up", daemon=True).start()
        launch(build(studio), studio, theme=theme(), head=STYLE)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        sys.exit(130)
