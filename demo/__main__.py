"""Start the web page: `python app.py` or `python -m demo` in a checkout, else `phy124-demo`."""

from __future__ import annotations

from phy124.runtime.signals import ending, handling

with handling(ending(130)):  # an error message instead of a traceback
    import atexit
    import inspect
    import os
    import sys
    import threading
    from argparse import ArgumentParser
    from collections.abc import Sequence
    from contextlib import suppress
    from importlib import import_module
    from importlib.util import find_spec
    from typing import Any

    from phy124.errors import InputError
    from phy124.runtime.failures import Kind, failure
    from phy124.runtime.installation import install_command
    from phy124.runtime.memory import pause_collection, refuse_narrow, share_heap
    from phy124.runtime.streams import steady_streams

    from .settings import PREFIX, Settings


def run() -> int:
    """Serve the page as a program, and return its exit status.

    Jobs run in daemon threads. When Python ends such a thread inside a C++ library, such as OpenCV,
    the library aborts the process. The process therefore ends before Python ends its threads.
    """
    status: Any = 1

    def leave() -> None:
        with suppress(OSError, ValueError):
            sys.stdout.flush()
        os._exit(status)

    atexit.register(leave)  # Functions that are registered later run earlier.
    try:
        status = main()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
        raise
    return status


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the page until it is interrupted; return the exit status of the process."""
    chosen = read_options(arguments)
    with steady_streams():
        try:
            refuse_narrow()
            serve(Settings.from_environment({**os.environ, **chosen}))
        except SystemExit:
            raise
        except BaseException as problem:
            ending = failure(problem)
            if ending.kind is not Kind.STOPPED:
                print(f"phy124-demo: {ending.sentence}", file=sys.stderr)
            return ending.status
    return 0


def import_gradio() -> None:
    """Import gradio without its generation of .pyi files; this saves a third of the import time.

    On every import, gradio derives a .pyi file (for editors) from the source code of each component
    whose source file is known.
    """
    usual = inspect.getfile

    def find(thing: Any) -> str:
        if getattr(thing, "__module__", "").startswith("gradio."):
            raise OSError
        return usual(thing)

    inspect.getfile = find
    try:
        import_module("gradio")
    finally:
        inspect.getfile = usual


def serve(settings: Settings) -> None:
    """Serve the page until it is interrupted.

    Raises:
        InputError: gradio is not installed, or a setting cannot be used.
    """
    if find_spec("gradio") is None:
        limit = "The page needs the package gradio, which is not installed."
        raise InputError("page", "gradio", limit, f"Run `{install_command('demo')}`.")
    share_heap()
    with pause_collection():
        import_gradio()
        from .folder import lock_folder
        from .server import check_address, end_on_signals, launch, prepare

    check_address(settings)
    end_on_signals()
    with lock_folder(settings.folder) as root:
        prepare(settings, root)
        with pause_collection():
            from .ui import STYLE, build, open_studio, theme

        studio = open_studio(settings, root)
        threading.Thread(target=studio.warm_up, name="warm-up", daemon=True).start()
        launch(build(studio), studio, theme=theme(), head=STYLE)


def read_options(arguments: Sequence[str] | None) -> dict[str, str]:
    """Return options as environment variables, such as PHY124_PORT=80 for --port 80."""
    parser = ArgumentParser(
        prog="phy124-demo",
        usage="%(prog)s [--port 7860] [--max-frames 72] ...",
        description="Serve the web page. Every option can also be set as an environment variable.",
    )
    for name, field in Settings.model_fields.items():
        variable = PREFIX + name.upper()
        default = "none" if field.default == "" else field.default
        text = f"{field.description} Default: {default}. {variable}"
        parser.add_argument(f"--{name.replace('_', '-')}", dest=variable, metavar="", help=text)
    typed = list(sys.argv[1:] if arguments is None else arguments)
    if typed[-1:] == ["--"]:  # Nothing follows the end of the options.
        typed.pop()
    options = vars(parser.parse_args(typed))
    return {variable: value for variable, value in options.items() if value is not None}


if __name__ == "__main__":
    sys.exit(run())
