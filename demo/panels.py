"""The page's own panels: gr.HTML components; their scripts are in static/ and phy124/io/viewer/."""

from __future__ import annotations

from typing import Any

import gradio as gr

HEAD = '<script src="phy124/static/server.js"></script>'
HEAD += '<script src="phy124/static/page.js"></script>'
PICTURE = HEAD + '<script src="phy124/static/brush.js"></script>'
PICTURE += '<script src="phy124/static/picture.js"></script>'
KNOWN = HEAD + '<script src="phy124/static/ways.js"></script>'
KNOWN += '<script src="phy124/static/known.js"></script>'
OTHERS = KNOWN + '<script src="phy124/static/others.js"></script>'
EDITOR = HEAD + '<script src="phy124/static/links.js"></script>'
EDITOR += '<script src="phy124/static/form.js"></script>'
EDITOR += '<script src="phy124/static/scene.js"></script>'
TOUCH = (
    HEAD
    + '<script src="phy124/static/lattice.js"></script>'
    + '<script src="phy124/static/glass.js"></script>'
    + '<script src="phy124/static/splats.js"></script>'
    + '<script src="phy124/static/touch.js"></script>'
)
FIT = (
    HEAD
    + '<script src="phy124/viewer/compare.js"></script>'
    + '<script src="phy124/static/fit.js"></script>'
    + '<link rel="stylesheet" href="phy124/viewer/compare.css">'
)
PLAYER = (
    HEAD
    + '<script src="phy124/viewer/vendor/playcanvas.min.js"></script>'
    + '<script src="phy124/viewer/pack.js"></script>'
    + '<script src="phy124/viewer/stage.js"></script>'
    + '<script src="phy124/viewer/shine.js"></script>'
    + '<script src="phy124/viewer/player.js"></script>'
    + '<link rel="stylesheet" href="phy124/viewer/player.css">'
)


def scene() -> gr.HTML:
    """The scene editor; its value is a scene as plain data. "change" reports a new one."""
    return _panel("scene", EDITOR, events="'change'")


def picture() -> gr.HTML:
    """The picture, its cut-out, the brush, and examples to start with.

    Events: "choose" names a file that was sent or an example, "correct" carries brush strokes,
    "cut" reports that cutting out has ended.
    """
    return _panel("picture", PICTURE, events="'choose' 'correct' 'cut'")


def known() -> gr.HTML:
    """What else is known of the object; its value holds that by option.

    Events: "choose" names a picture that was sent for an option, "view" reports that it has been
    cut out, "change" that the value has changed. Handlers give an answer as the value, which the
    panel replaces, and so are the ways up of a file of Gaussians.
    """
    return _panel("known", KNOWN, events="'choose' 'view' 'change'")


def others() -> gr.HTML:
    """Pictures of the scene's further objects; empty if it has none that waits for a picture.

    Events: "choose" names a picture that was sent for an object, "view" reports that it has been
    cut out. Handlers give an answer as the value; the scene itself holds the pictures.
    """
    return _panel("others", OTHERS, events="'choose' 'view'")


def progress() -> gr.HTML:
    """Stages with bars, and the run so far; the events "finished" and "again" report its end."""
    return _panel("progress", HEAD, events="'finished' 'again'")


def viewer() -> gr.HTML:
    """The 4D viewer."""
    return _panel("viewer", PLAYER)


def touch() -> gr.HTML:
    """The object in the visitor's hand; its value says where the live run is.

    Events: "begin" asks for a live run, "save" for the clip of what was done.
    """
    return _panel("touch", TOUCH, events="'begin' 'save'")


def forecast() -> gr.HTML:
    """The forecast as HTML; the event "measure" asks for the error of the scene."""
    return gr.HTML(
        "",
        js_on_load="Phy124.forecast(element, trigger); // 'measure'",
        head=HEAD,
        apply_default_css=False,
        elem_id="forecast",
    )


def history() -> gr.HTML:
    """Earlier results; the event "show" asks for one of them."""
    return _panel("history", HEAD, events="'show'")


def videos() -> gr.HTML:
    """The videos side by side."""
    return _panel("videos", HEAD)


def takeaway() -> gr.HTML:
    """Links to files, and buttons for those made on demand (the event "prepare")."""
    return _panel("takeaway", HEAD, events="'prepare'")


def fit() -> gr.HTML:
    """A video that the result is fitted to; its value says what a fit takes, or has found.

    Events: "begin" names a video that was sent, "stop" cancels its fit, "ended" reports its end.
    """
    return _panel("fit", FIT, events="'begin' 'stop' 'ended'")


def _panel(name: str, head: str, events: str = "") -> gr.HTML:
    """A panel drawn by the function of that name in the script object `Phy124`."""
    call = f"Phy124.{name}(element, props, watch, trigger);"
    value: Any = None
    # Gradio finds the names of events in the text of the script.
    return gr.HTML(
        value,
        html_template="",
        js_on_load=f"{call} // {events}",
        head=head,
        apply_default_css=False,
        elem_id=name,
    )
