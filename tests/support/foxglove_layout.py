"""The layout that is shipped, built with Foxglove's own classes.

`python tests/support/foxglove_layout.py` writes bridge/foxglove/phy124.json again.
"""

import json
from pathlib import Path

import foxglove.layouts as fl

SHIPPED = Path(__file__).parents[2] / "bridge/foxglove/phy124.json"
NODE = "/phy124/live"


def button(service: str, request: dict, text: str) -> fl.SplitItem:
    config = fl.ServiceCallConfig(
        service_name=f"{NODE}/{service}",
        request_payload=json.dumps(request),
        button_text=text,
        editing_mode=False,
        timeout_seconds=60,
    )
    return fl.SplitItem(content=fl.ServiceCallPanel(config=config, title=text))


def publish(topic: str, datatype: str, value: dict, text: str) -> fl.SplitItem:
    config = fl.PublishConfig(
        topic_name=f"{NODE}/{topic}",
        datatype=datatype,
        button_text=text,
        advanced_view=False,
        value=json.dumps(value),
    )
    return fl.SplitItem(content=fl.PublishPanel(config=config, title=text))


def plot(title: str, *paths: tuple[str, str]) -> fl.SplitItem:
    series = [fl.PlotSeries(value=value, label=label, enabled=True) for value, label in paths]
    config = fl.PlotConfig(paths=series, show_legend=True, legend_display="floating")
    return fl.SplitItem(content=fl.PlotPanel(config=config, title=title))


def upward(newtons: float) -> dict:
    return {"wrench": {"force": {"x": 0, "y": 0, "z": newtons}}}


def layout() -> fl.Layout:
    view = fl.ThreeDeeConfig(
        follow_tf="map",
        topics={
            "/phy124/points": fl.BaseRendererPointCloudTopicSettings(
                visible=True, color_mode="rgb", color_field="rgb", point_size=3
            )
        },
        publish=fl.ThreeDeePublishSettings(type="point", point_topic=f"{NODE}/grab"),
    )
    factor = f"{NODE}/real_time_factor.data"
    force = f"{NODE}/contact/ground.wrench.force"
    plots = fl.SplitContainer(
        direction="column",
        items=[
            plot(
                "Force on the ground [N]",
                (f"{force}.x", "x"),
                (f"{force}.y", "y"),
                (f"{force}.z", "z"),
            ),
            plot("Real-time factor", (factor, "simulated seconds per second")),
        ],
    )
    state = "set_simulation_state"
    buttons = fl.SplitContainer(
        direction="row",
        items=[
            button(state, {"state": {"state": 1}}, "Play"),
            button(state, {"state": {"state": 2}}, "Pause"),
            button("step_simulation", {"steps": 1}, "Step"),
            button("reset_simulation", {"scope": 0}, "Reset"),
            publish("push", "geometry_msgs/WrenchStamped", upward(4000.0), "Push up"),
            publish("grab", "geometry_msgs/PointStamped", {}, "Let go"),
        ],
    )
    upper = fl.SplitContainer(
        direction="row",
        items=[
            fl.SplitItem(proportion=2, content=fl.ThreeDeePanel(config=view, title="Object")),
            fl.SplitItem(proportion=1, content=plots),
        ],
    )
    return fl.Layout(
        content=fl.SplitContainer(
            direction="column",
            items=[
                fl.SplitItem(proportion=5, content=upper),
                fl.SplitItem(proportion=1, content=buttons),
            ],
        )
    )


def text() -> str:
    return json.dumps(json.loads(layout().to_json()), indent=1) + "\n"


if __name__ == "__main__":
    SHIPPED.parent.mkdir(exist_ok=True)
    SHIPPED.write_text(text(), encoding="utf-8")
