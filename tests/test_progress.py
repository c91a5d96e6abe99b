"""How far long work is: what is told, shown and logged."""

import io
import logging
import re
from contextlib import suppress

import numpy as np
import pytest
from rich.console import Console

import fynjax as fx
from fynjax._core import progress as _progress
from fynjax._core.parts import Pool
from fynjax._core.progress import advance, stage, track
from fynjax.app.compare import read_drone_image
from fynjax.app.io.raster import write_geotiff
from tests.heard import hearing


def test_stages_and_steps_are_told_to_who_listens_and_to_nobody_after():
    with hearing() as heard:
        with stage("Read", 2):
            advance(2, match=0.5)
            assert list(track("ab", "Letters")) == ["a", "b"]
        assert list(track(iter("abc"), "More letters", 3)) == ["a", "b", "c"]
    advance()
    assert heard.stages == [("Read", 2), ("Letters", 2), ("More letters", 3)]
    assert heard.steps == [2, 1, 1, 1, 1, 1]
    assert heard.shown[0] == {"match": 0.5}


def test_the_innermost_listener_hears_alone_also_after_an_error():
    with hearing() as outer:
        with pytest.raises(KeyboardInterrupt), hearing(2) as inner:
            advance(2)
        advance(3)
    assert (outer.count, inner.count) == (3, 2)


def test_bars_show_stages_counts_and_what_the_work_tells():
    console = Console(force_terminal=True, width=120, record=True, file=io.StringIO())
    with fx.progress(console):
        advance()  # outside a stage: nothing to move
        with stage("Calibrate", total=10):
            advance(4, loss=0.5)
            with stage("Render"):
                advance()
            advance(1, loss=0.25)
    text = console.export_text()
    assert "Calibrate" in text
    assert "  Render" in text
    assert "loss 0.25" in text
    assert "10/10" in text


def test_a_loop_that_ends_early_closes_its_bar():
    console = Console(force_terminal=True, width=120, record=True, file=io.StringIO())
    with fx.progress(console):
        for _ in track(range(7), "Search"):
            break
        with stage("Write"):
            pass
    lines = [line.strip(" ⠋✓") for line in console.export_text().splitlines()]
    assert any(re.match("Search .*0/7", line) for line in lines)
    assert not any(line.startswith("  Write") for line in lines)  # not within the loop


def test_without_a_terminal_a_stage_is_a_line_with_time_used_and_left(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(_progress.time, "perf_counter", lambda: now[0])
    file = io.StringIO()
    with fx.progress(Console(file=file, width=20)):
        with stage("Read"):
            now[0] += 0.5
        with stage("Calibrate [plot]", 10):
            for loss in (5.0, 4.0, 3.0):
                now[0] += 20.0
                advance(loss=loss)
            with stage("Render"):
                now[0] += 200.0
        with stage("Search", 5):  # its first step compiles
            for took in (100.0, 40.0):
                now[0] += took
                advance(loss=2.0)
        advance()  # outside a stage
        with suppress(ValueError), stage("Write"):  # what failed has no time
            now[0] += 5.0
            raise ValueError
    assert file.getvalue().splitlines() == [
        "Calibrate [plot]: 2 of 10, 2 min 40 s left  loss 4",
        "  Render: 3 min 20 s",
        "Calibrate [plot]: 4 min 20 s",
        "Search: 1 of 5  loss 2",
        "Search: 2 of 5, 2 min 0 s left  loss 2",
        "Search: 2 min 20 s",
    ]


def test_nothing_is_shown_unasked_but_stages_are_logged(capfd, caplog):
    with caplog.at_level(logging.INFO, logger="fynjax"):
        list(track(range(3), "Plantings"))
    assert capfd.readouterr() == ("", "")
    begun, took = (record.getMessage() for record in caplog.records)
    assert begun == "Plantings: begins"
    assert re.fullmatch(r"Plantings: took \d+\.\d s", took)
    assert {record.name for record in caplog.records} == {"fynjax"}


def staged(number):
    with stage("within"):
        advance()
    return (np.array(number),)


def test_parts_of_a_job_are_shown_and_not_what_is_within_them():
    with hearing() as heard, stage("Parts", 3):
        Pool().all(staged, range(3))
    assert heard.stages == [("Parts", 3)]
    assert heard.steps == [1, 1, 1]


def test_a_reader_tells_how_far_it_is(tmp_path):
    path = tmp_path / "drone.tif"
    levels = np.linspace(0.9, 1.1, 900).reshape(30, 30)
    bands = {"green": 0.05, "red": 0.04, "red_edge": 0.15, "nir": 0.30}
    write_geotiff(path, [v * levels for v in bands.values()], list(bands), pixel_m=0.1)
    with hearing() as heard:
        read_drone_image(path)
    assert heard.stages == [("Read drone.tif", heard.count)]
