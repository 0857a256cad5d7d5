"""The hosted page: `python app.py`, or a Hugging Face Space as it stands (docs/web.md)."""

import threading

from demo.server import launch, prepare
from demo.settings import Settings


def main() -> None:
    """Serve the page until interrupted."""
    settings = Settings.from_environment()
    root = prepare(settings)
    from demo.ui import STYLE, build, open_studio, theme

    studio = open_studio(settings, root)
    threading.Thread(target=studio.warm_up, name="warm-up", daemon=True).start()
    launch(build(studio), studio, theme=theme(), head=STYLE)


if __name__ == "__main__":
    main()
