"""A sweep: clips of two objects with three stiffnesses, made on all cores.

Install with `.venv/bin/pip install --editable '.[sweep]'`.
"""

from phy124.studies.sweep import Dataset, Plan, Sweep, run

declared = Sweep.from_data(
    {
        "pictures": ["demo/examples/duck.png", "demo/examples/teddy.png"],
        "gaussians": 5000,
        "scene": "press",
        "films": True,
        "set": {
            "accuracy": "draft",
            "time.frames": 10,
            "view.views": [["front"]],
            "material.E": {"first": 1e4, "last": 1e6, "count": 3, "spacing": "log"},
        },
    }
)
run(Plan(declared), "out/sweep-example")
for row, clip in Dataset("out/sweep-example"):
    print(row["picture"], row["set.material.E"], f"{clip.means[-1, :, 2].max():.2f} m")
