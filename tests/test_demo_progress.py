"""The progress panel follows the events of the job."""

import json

from demo.progress import MEASURING, STAGES, Glimpse, Live, Measured, Progress, Reused, Step


def test_stages_are_listed_from_the_start_and_fill():
    progress = Progress(expected=3.0)
    assert [row["name"] for row in progress.data()["stages"]] == list(STAGES.values())
    for event in (Reused("generate"), Step("simulate", 3, 14, "a note"), None):
        progress.take(event)
    reused, simulate, render, _ = progress.data()["stages"]
    assert reused["reused"] and reused["note"] == "reused"
    assert (simulate["done"], simulate["total"], simulate["note"]) == (3, 14, "a note")
    assert (render["done"], render["total"], render["note"]) == (0, 0, "")


def test_pictures_are_sent_once_each():
    progress = Progress()
    for index in range(3):
        progress.take(Glimpse(bytes([index])))
        progress.take(Live(f"{index}.bin"))
    data = json.loads(json.dumps(progress.data(seen=1)))
    assert data["glimpses"] == ["AQ==", "Ag=="] and data["live"] == ["1.bin", "2.bin"]


def test_a_frame_without_its_file_waits_for_it():
    progress = Progress()
    progress.take(Glimpse(b"0"))
    seen = len(progress.data()["glimpses"])  # the page asks before the file is written
    progress.take(Live("0.bin"))
    assert progress.data(seen)["live"] == ["0.bin"]


def test_its_turn_and_its_end(tmp_path):
    progress = Progress(names=MEASURING)
    assert progress.data()["state"] == "waiting"
    progress.begin()
    assert progress.data()["state"] == "running" and progress.data()["elapsed"] >= 0
    progress.take(Measured(tmp_path))
    assert progress.data()["state"] == "done" and progress.result == Measured(tmp_path)
