"""Requests of programs: their arguments as models."""


def test_extras_leave_out_the_scene_and_compose(gradio):
    from demo.endpoints import GenerateRequest, MeasureRequest

    asked = {"image": "a.png", "preset": "press", "accuracy": "draft", "side": "b.png"}
    extras = MeasureRequest(**asked).extras
    assert extras["side"] == "b.png" and not {"image", "preset", "compose"} & set(extras)
    assert GenerateRequest(**asked, compose=True).extras == {**extras, "compose": True}
