"""LeRobot datasets: folders made with pyarrow and pandas are read exactly, and ours by them."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import commands
import numpy as np
import pandas as pd
import polars
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import strategies as s
from depth import DEEP, examples
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import hapfmt
from hapfmt import Event
from hapfmt.clocks import ClockMap, ClockObservation
from hapfmt.convert import imported, read, save
from hapfmt.errors import HapfmtError, LimitError, MissingExtraError, ParameterError
from hapfmt.recording import Calibration, Channel, Recording, Span

pytestmark = pytest.mark.filterwarnings("ignore::hapfmt.errors.DataWarning")
SCALAR = {"shape": [1], "names": None}
FRAME = {
    "timestamp": {"dtype": "float32", **SCALAR},
    **{name: {"dtype": "int64", **SCALAR}
       for name in ("frame_index", "episode_index", "index", "task_index")},
}  # fmt: skip
JOINTS = ["pan", "lift", "grip"]
FEATURES = {
    "observation.state": {"dtype": "float32", "shape": [3], "names": {"motors": JOINTS}},
    "action": {"dtype": "float32", "shape": [3], "names": JOINTS},
    "wrench": {"dtype": "float64", "shape": [2, 2], "names": None},
    "force": {"dtype": "int16", "shape": [1], "names": ["fz [N]"]},
    "next.done": {"dtype": "bool", **SCALAR},
    "top": {"dtype": "video", "shape": [4, 4, 3], "names": ["height", "width", "channels"]},
    "wrist": {"dtype": "image", "shape": [4, 4, 3], "names": ["height", "width", "channels"]},
    "phase": {"dtype": "string", **SCALAR},
    **FRAME,
}
LENGTHS = [40, 50, 7]


def rows(first: int = 0, lengths: list[int] = LENGTHS, fps: float = 30) -> pa.Table:
    """Episodes one behind the other, as LeRobot stores them."""
    count = sum(lengths)
    frame = np.concatenate([np.arange(n) for n in lengths])
    episode = np.repeat(np.arange(first, first + len(lengths)), lengths)
    x = np.random.default_rng(first).normal(size=(count, 3)).astype(np.float32)
    wrench = (x[:, :1, None] * np.ones((2, 2))).astype(np.float64)
    picture = pa.array([{"bytes": b"png", "path": "a.png"}] * count)
    return pa.table(
        {
            "observation.state": pa.FixedSizeListArray.from_arrays(pa.array(x.ravel()), 3),
            "action": pa.array((x + 1).tolist(), pa.list_(pa.float32())),
            "wrench": pa.array(wrench.tolist(), pa.list_(pa.list_(pa.float64()))),
            "force": pa.array(np.arange(count) - 5, pa.int16()),
            "next.done": pa.array(frame == np.repeat(np.array(lengths) - 1, lengths)),
            "wrist": picture,
            "phase": np.where(frame < 5, "near", "touch"),
            "timestamp": (frame / fps).astype(np.float32),
            "frame_index": frame,
            "episode_index": episode,
            "index": np.arange(count),
            "task_index": episode % 2,
        }
    )


def v3(root: Path, tables: list[pa.Table] | None = None, **info: Any) -> Path:
    """Version 3: all episodes in one file, here in small row groups, or one table a file."""
    files = [rows()] if tables is None else tables
    listed = []
    at = 0
    for number, table in enumerate(files):
        path = root / f"data/chunk-000/file-{number:03d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table, path, row_group_size=11)
        for episode in dict.fromkeys(table["episode_index"].to_pylist()):
            length = table["episode_index"].to_pylist().count(episode)
            listed.append(
                {"episode_index": episode, "tasks": ["pick"], "length": length,
                 "data/chunk_index": 0, "data/file_index": number,
                 "dataset_from_index": at, "dataset_to_index": at + length,
                 "stats/action/mean": [0.0, 1.0]}
            )  # fmt: skip
            at += length
    path = root / "meta/episodes/chunk-000/file-000.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.Table.from_pylist(listed), path)
    pd.DataFrame({"task_index": [0, 1]}, index=["pick", "place"]).to_parquet(
        root / "meta/tasks.parquet"
    )
    write_info(root, codebase_version="v3.0",
               data_path="data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet", **info)  # fmt: skip
    return root


def v2(root: Path, lengths: list[int] = LENGTHS, **info: Any) -> Path:
    """Version 2.1: a file for each episode."""
    table = rows(lengths=lengths)
    for number in range(len(lengths)):
        path = root / f"data/chunk-000/episode_{number:06d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table.filter(pa.compute.equal(table["episode_index"], number)), path)
    (root / "meta").mkdir()
    episodes = [{"episode_index": i, "tasks": ["pick"], "length": n} for i, n in enumerate(lengths)]
    tasks = [{"task_index": 0, "task": "pick"}, {"task_index": 1, "task": "place"}]
    for name, lines in (("episodes", episodes), ("tasks", tasks)):
        text = "".join(f"{json.dumps(line)}\n" for line in lines)
        (root / f"meta/{name}.jsonl").write_text(text, "utf-8")
    write_info(root, codebase_version="v2.1", chunks_size=1000,
               data_path="data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
               **info)  # fmt: skip
    return root


def write_info(root: Path, **info: Any) -> None:
    about = {"robot_type": "so100", "fps": 30, "features": FEATURES, **info}
    (root / "meta/info.json").write_text(json.dumps(about), "utf-8")


def facts(channel: Channel):
    return (
        channel.stored.tobytes(), channel.stored.dtype, channel.rate_exact, channel.coverage,
        channel.calibration, channel.label, channel.unit, channel.quantity, channel.axis,
        channel.group, channel.body_site, channel.device, channel.lsb,
    )  # fmt: skip


@pytest.fixture(params=[v2, v3])
def dataset(request, tmp_path) -> Path:
    return request.param(tmp_path / "set")


class TestForeign:
    def test_an_episode(self, dataset):
        found = read(dataset, episode=1)
        table = rows().slice(40, 50)
        assert found.labels == [
            *(f"observation.state.{name}" for name in JOINTS), *(f"action.{name}" for name in JOINTS),
            "wrench.0.0", "wrench.0.1", "wrench.1.0", "wrench.1.1", "fz", "next.done",
        ]  # fmt: skip
        assert {(c.rate_exact, c.coverage) for c in found} == {(30, (Span(0, 50),))}
        state = np.array(table["observation.state"].to_pylist(), np.float32)
        action = np.array(table["action"].to_pylist(), np.float32)
        for place, name in enumerate(JOINTS):
            assert found[f"observation.state.{name}"].stored.tobytes() == state[:, place].tobytes()
            assert found[f"action.{name}"].stored.tobytes() == action[:, place].tobytes()
        wrench = np.array(table["wrench"].to_pylist())
        assert found["wrench.1.0"].stored.tobytes() == wrench[:, 1, 0].tobytes()
        assert found["fz"].counts.tolist() == table["force"].to_pylist()
        assert found["fz"].unit == "N" and found["fz"].group == "force"
        assert found["next.done"].stored.tolist() == [0] * 49 + [1]
        assert found["action.pan"].group == "action"
        notes = found.metadata.pop("notes")
        assert notes == ["the video 'top' is not read", "the images 'wrist' are not read"]
        assert found.metadata == {"episode": 1, "robot_type": "so100", "task": "place"}
        assert [(e.time, e.duration, e.text, e.layer) for e in found.events] == [
            (0, Fraction(1, 6), "near", "phase"),
            (Fraction(1, 6), Fraction(3, 2), "touch", "phase"),
        ]

    def test_which_episode(self, dataset):
        with pytest.raises(ParameterError, match=r"3 episodes \(0 to 2\); choose one \(episode=\)"):
            read(dataset)
        for wrong in ("3", "-1", "a", "1 ", "99999999999999999999"):
            with pytest.raises(ParameterError, match=r"no episode .*; the dataset has 0 to 2"):
                read(dataset, episode=wrong)
        assert [len(read(dataset, episode=n)[0].stored) for n in range(3)] == LENGTHS

    def test_select(self, dataset):
        assert read(dataset, episode=0, select="action").labels == [f"action.{n}" for n in JOINTS]
        found = read(dataset, episode=0, select=["obs*", "force"])
        assert len(found) == 4 and not found.events
        with pytest.raises(ParameterError, match="no column 'wrist'"):
            read(dataset, episode=0, select="wrist")

    def test_values_are_read_later(self, dataset):
        with imported(dataset, episode=1) as (chosen, found):
            assert chosen.name == "lerobot" and found.size == 50 * (6 * 4 + 4 * 8 + 2 * 4)
            shutil.rmtree(dataset / "data")
            with pytest.raises(ParameterError, match=r"folder lacks a file: .*parquet"):
                next(found.blocks())

    def test_one_episode_needs_no_number(self, tmp_path):
        assert len(read(v2(tmp_path / "a", [9]))[0].stored) == 9
        assert len(read(v3(tmp_path / "b", [rows(7, [8])]))[0].stored) == 8

    def test_an_episode_without_frames(self, tmp_path):
        found = read(v2(tmp_path / "a", [0]), select=["force", "next.done"])
        assert [channel.stored.size for channel in found] == [0, 0] and not found.events

    def test_several_files(self, tmp_path):
        root = v3(tmp_path / "a", [rows(0, [5, 6]), rows(5, [7, 8])])
        assert [len(read(root, episode=n)[0].stored) for n in (0, 1, 5, 6)] == [5, 6, 7, 8]
        with pytest.raises(ParameterError, match=r"4 episodes \(0, 1, 5, 6\)"):
            read(root)

    def test_several_tasks_are_events(self, tmp_path):
        table = rows(0, [10])
        place = table.column_names.index("task_index")
        table = table.set_column(place, "task_index", pa.array([1] * 4 + [0] * 6))
        found = read(v3(tmp_path / "a", [table]))
        tasks = [(e.time * 30, e.duration * 30, e.text) for e in found.events if e.layer == "task"]
        assert tasks == [(0, 4, "place"), (4, 6, "pick")] and "task" not in found.metadata
        table = table.set_column(place, "task_index", pa.array([9] * 10))
        found = read(v3(tmp_path / "a", [table]))
        assert "the dataset names no task 9" in found.metadata["notes"]

    def test_subtasks(self, tmp_path):
        features = {**FEATURES, "subtask_index": {"dtype": "int64", **SCALAR}}
        table = rows(0, [4]).append_column("subtask_index", pa.array([0, 0, 1, 1]))
        root = v3(tmp_path / "a", [table], features=features)
        assert "subtask_index" in read(root).labels
        frame = pd.DataFrame({"subtask_index": [0, 1]}, index=pd.Index(["a", "b"], name="subtask"))
        frame.to_parquet(root / "meta/subtasks.parquet")
        found = read(root)
        assert "subtask_index" not in found.labels
        assert [e.text for e in found.events if e.layer == "subtask"] == ["a", "b"]

    @pytest.mark.parametrize(
        ("names", "labels"),
        [
            (None, ["x.0", "x.1"]),
            (["a", "b"], ["a", "b"]),
            ([["a", "b"]], ["a", "b"]),
            ({"left": ["a"], "right": ["b"]}, ["a", "b"]),
            (["a", "b", "c"], ["x.0", "x.1"]),
            (["a", 5], ["x.0", "x.1"]),
            ("ab", ["x.0", "x.1"]),
            (["a", "a"], ["a", "a (2)"]),
        ],
    )
    def test_names(self, tmp_path, names, labels):
        features = {"x": {"dtype": "float32", "shape": [2], "names": names}}
        table = pa.table({"x": pa.array([[1.0, 2.0]] * 3), "episode_index": [0] * 3})
        assert read(v3(tmp_path / "a", [table], features=features)).labels == labels

    def test_columns_that_do_not_fit(self, tmp_path):
        features = {**FEATURES, "tactile": {"dtype": "float32", "shape": [9], "names": None}}
        table = rows(0, [3]).append_column("odd", pa.array([1, 2, 3]))
        notes = read(v3(tmp_path / "a", [table], features=features)).metadata["notes"]
        assert "the feature 'tactile' has no column" in notes
        assert "the column 'odd' is not a feature in meta/info.json, and is not read" in notes

    def test_lengths_that_differ(self, tmp_path):
        root = v2(tmp_path / "a", [9])
        path = root / "meta/episodes.jsonl"
        path.write_text(path.read_text("utf-8").replace("9}", "8}"), "utf-8")
        (note,) = [n for n in read(root).metadata["notes"] if "frames" in n]
        assert note == "meta/episodes.jsonl says 8 frames, and there are 9"


def frames(times: Any, fps: float, root: Path, numbers: Any = None) -> Path:
    times = np.asarray(times)
    table = pa.table(
        {
            "x": np.arange(times.size) * 1.0,
            "timestamp": times.astype(np.float32),
            "frame_index": np.arange(times.size) if numbers is None else numbers,
            "episode_index": np.zeros(times.size, np.int64),
        }
    )
    features = {"x": {"dtype": "float64", **SCALAR}, **FRAME}
    return v3(root, [table], features=features, fps=fps)


class TestTimes:
    @pytest.mark.parametrize("fps", [10, 29.97, 59.94, 1000, 0.5])
    def test_the_rate_is_exact(self, tmp_path, fps):
        found = read(frames(np.arange(5000) / fps, fps, tmp_path / "a"))
        assert found[0].rate_exact == Fraction(str(fps))
        assert found[0].coverage == (Span(0, 5000),) and "notes" not in found.metadata

    def test_late_stamps_are_noted_and_kept(self, tmp_path):
        times = np.arange(100) / 30
        times[7] += 0.004
        root = frames(times, 30, tmp_path / "a")
        found = read(root)
        assert found.metadata["notes"] == [
            "the time stamps differ from 30 frames per second by up to 0.004 s"
        ]
        kept = read(root, keep_stamps=True)
        stamps = np.float32(times).astype(float) * 1e9
        expected = np.rint(stamps) - np.arange(100) * 10**9 // 30
        assert kept.labels == ["x", "stamp"] and kept["stamp"].stored.tolist() == expected.tolist()

    def test_stamps_of_another_rate(self, tmp_path):
        root = frames(np.arange(300) / 25, 30, tmp_path / "a")
        with pytest.raises(
            ParameterError, match=r"by up to 0.997 s; place .*\(clock='frame_index'\)"
        ):
            read(root)
        assert read(root, clock="frame_index")[0].rate_exact == 30
        found = read(root, rate=25)
        assert found[0].rate_exact == 25
        assert found.metadata["notes"] == ["the rate of the file, 30 Hz, was overridden by 25 Hz"]
        with pytest.raises(ParameterError, match="clock"):
            read(root, clock="log")

    def test_lost_frames(self, tmp_path):
        ticks = np.delete(np.arange(100), range(40, 50))
        by_number = frames(ticks / 30, 30, tmp_path / "a", ticks)
        found = read(by_number)
        assert found[0].coverage == (Span(0, 40), Span(50, 100))
        assert found.metadata["notes"] == ["missing frames: 10"]
        by_time = read(frames(ticks / 30, 30, tmp_path / "b"), clock="timestamp")
        assert by_time[0].coverage == (Span(0, 40), Span(50, 100))

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -1e30])
    def test_stamps_that_are_none(self, tmp_path, bad):
        root = frames([0, bad, 1], 30, tmp_path / "a")
        for options in ({}, {"clock": "timestamp"}, {"keep_stamps": True}):
            with pytest.raises(ParameterError, match=r"finite|differ"):
                read(root, **options)

    def test_numbers_that_do_not_rise(self, tmp_path):
        for numbers in ([0, 2, 1], [0, 0, 1]):
            with pytest.raises(ParameterError, match="do not rise"):
                read(frames([0, 1, 2], 1, tmp_path / "a", numbers))
        with pytest.raises(ParameterError, match="too far"):
            read(frames([0, 1, 2], 1, tmp_path / "a", [0, 1, 1 << 60]), clock="frame_index")

    def test_no_stamps(self, tmp_path):
        table = pa.table({"x": np.arange(3.0)})
        root = v3(tmp_path / "a", [table.append_column("episode_index", pa.array([0] * 3))],
                  features={"x": {"dtype": "float64", **SCALAR}})  # fmt: skip
        assert read(root)[0].stored.tolist() == [0, 1, 2]
        with pytest.raises(ParameterError, match="no time stamps"):
            read(root, clock="timestamp")


# What we write


RECORDING = Recording(
    (
        Channel(np.arange(3000, dtype=np.int32), 1000, calibration=Calibration(1, -3, 100),
                label="fx", unit="N", quantity="force", axis="x", device="ATI", lsb=0.01),
        Channel(np.sin(np.arange(1000.0)), 1000, (Span(5, 505), Span(700, 1200)), label="fy"),
        Channel(np.arange(24000, dtype=np.float32), 8000, label="acc", unit="m/s2"),
        Channel(np.arange(60) - 5, 20, label="gripper", group="action"),
        Channel(np.arange(2995, dtype=np.int32), 1000, (Span(5, 3000),),
                Calibration(3, 0, 7), label="fz", body_site="tip"),
        Channel(np.arange(7, dtype=np.int16) * 9, 1000, (Span(1, 8),), label="mode"),
    ),
    epoch_ns=1_700_000_000_000_000_001,
    epoch_uncertainty_ns=9,
    metadata={"task": "press", "robot_type": "hand", "nested": {"a": [1, None]}},
    events=(Event(Fraction(1, 3), "touch", Fraction(1, 7), 1, "marks"),),
    clocks=(ClockObservation("pc", 0, 3, 10**18, 5),),
    clock_maps=(ClockMap("pc", 0, ((0, 5), (10, 99))),),
)  # fmt: skip


def data_of(root: Path) -> pa.Table:
    return pq.read_table(root / "data/chunk-000/file-000.parquet")


class TestOurs:
    def test_everything_comes_back(self, tmp_path):
        notes = save(RECORDING, tmp_path / "a", format="lerobot", fps=20)
        assert notes == ("gaps and samples that frames lack at the ends are NaN: 4998",)
        found = read(tmp_path / "a")
        assert [*map(facts, found)] == [*map(facts, RECORDING)]
        for name in ("epoch_ns", "epoch_uncertainty_ns", "events", "clocks", "clock_maps",
                     "metadata"):  # fmt: skip
            assert getattr(found, name) == getattr(RECORDING, name)

    def test_what_others_see(self, tmp_path):
        root = tmp_path / "a"
        save(RECORDING, root, format="lerobot", fps=20)
        info = json.loads((root / "meta/info.json").read_text("utf-8"))
        assert info["codebase_version"] == "v3.0" and info["fps"] == 20
        assert (info["total_frames"], info["robot_type"]) == (60, "hand")
        shapes = {name: (one["dtype"], one["shape"]) for name, one in info["features"].items()}
        assert shapes == {
            "observation.touch": ("float64", [50, 4]), "observation.touch_2": ("float32", [400, 1]),
            "action": ("int64", [1]), "timestamp": ("float32", [1]), "frame_index": ("int64", [1]),
            "episode_index": ("int64", [1]), "index": ("int64", [1]), "task_index": ("int64", [1]),
        }  # fmt: skip
        assert info["features"]["observation.touch"]["names"] == {
            "channels": ["fx", "fy", "fz", "mode"]
        }
        touch = polars.read_parquet(root / info["data_path"].format(chunk_index=0, file_index=0))
        x = np.array(touch["observation.touch"].to_list()).reshape(3000, 4)
        assert x[:, 0].tolist() == RECORDING["fx"].samples().tolist()
        known = ~np.isnan(x[:, 1])
        assert np.flatnonzero(known).tolist() == [*range(5, 505), *range(700, 1200)]
        assert x[known, 1].tolist() == RECORDING["fy"].stored.tolist()
        assert touch["timestamp"].to_list() == (np.arange(60) / 20).astype(np.float32).tolist()
        assert touch["action"].to_list() == RECORDING["gripper"].stored.tolist()
        tasks = pd.read_parquet(root / "meta/tasks.parquet")
        assert tasks.loc["press"].task_index == 0 and tasks.iloc[0].name == "press"
        (episode,) = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
        assert (episode["length"], episode["tasks"], episode["dataset_to_index"]) == (
            60,
            ["press"],
            60,
        )

    def test_statistics(self, tmp_path):
        values = np.random.default_rng(4).normal(3, 2, 200_000)
        values[7] = 50
        recording = Recording((Channel(values, 100, label="x", group="observation.state"),))
        save(recording, tmp_path / "a", format="lerobot", fps=50)
        found = json.loads((tmp_path / "a/meta/stats.json").read_text("utf-8"))["observation.state"]
        wide = values.reshape(-1, 2, 1)
        for name in ("min", "max", "mean", "std"):
            assert np.allclose(found[name], getattr(np, name)(wide, axis=0), rtol=1e-12)
        assert found["count"] == [100_000]
        (row,) = pq.read_table(tmp_path / "a/meta/episodes/chunk-000/file-000.parquet").to_pylist()
        assert row["stats/observation.state/mean"] == found["mean"]

    def test_tasks_of_frames(self, tmp_path):
        events = (
            Event(1, "press", 1, layer="task"),
            Event(Fraction(5, 2), "lift", 9, layer="task"),
        )
        recording = Recording((Channel(np.arange(300.0), 100, (Span(100, 400),)),), events=events)
        save(recording, tmp_path / "a", format="lerobot", fps=10)
        assert data_of(tmp_path / "a")["task_index"].to_pylist() == [1] * 10 + [0] * 5 + [2] * 15
        assert pd.read_parquet(tmp_path / "a/meta/tasks.parquet").index.tolist() == [
            "",
            "press",
            "lift",
        ]
        assert read(tmp_path / "a").events == events

    def test_an_episode_from_lerobot_goes_back(self, tmp_path):
        found = read(v3(tmp_path / "a"), episode=2)
        save(found, tmp_path / "b", format="lerobot")
        again = data_of(tmp_path / "b")
        for name in ("observation.state", "action", "force"):
            assert again[name if name != "force" else "observation.force"].to_pylist() == (
                rows().slice(90)[name].to_pylist()
            )
        back = read(tmp_path / "b")
        assert [*map(facts, back)] == [*map(facts, found)]
        assert back.metadata["task"] == "pick" and back.metadata["episode"] == 2

    def test_a_dataset_to_which_others_added(self, tmp_path):
        """Windows and units are of the features; the rest was of our one episode."""
        root = tmp_path / "a"
        save(RECORDING, root, format="lerobot", fps=20)
        table = data_of(root)
        place = table.column_names.index("episode_index")
        more = table.set_column(place, "episode_index", pa.array([1] * 60))
        info = json.loads((root / "meta/info.json").read_text("utf-8"))
        v3(root, [pa.concat_tables([table, more])], fps=20, features=info["features"])
        found = read(root, episode=1)
        assert [*map(facts, found)] == [*map(facts, RECORDING)]
        assert found.epoch_ns is None and not found.events and found.metadata["task"] == "pick"

    def test_a_feature_that_others_added(self, tmp_path):
        root = tmp_path / "a"
        save(RECORDING, root, format="lerobot", fps=20)
        info = json.loads((root / "meta/info.json").read_text("utf-8"))
        info["features"]["reward"] = {"dtype": "float32", **SCALAR}
        v3(
            root,
            [data_of(root).append_column("reward", pa.array(np.arange(60.0)))],
            fps=20,
            features=info["features"],
        )
        found = read(root)
        assert [*map(facts, found)][:6] == [*map(facts, RECORDING)]
        assert found["reward"].rate_exact == 20 and found["reward"].stored[-1] == 59

    def test_blocks_are_small(self, tmp_path):
        recording = Recording((Channel(np.arange(1_200_000.0), 1000, label="x"),))
        save(recording, tmp_path / "a", format="lerobot", fps=1)
        with imported(tmp_path / "a") as (_, found):
            sizes = [block.values[0].size for block in found.blocks()]
        assert len(sizes) > 1 and max(sizes) * 8 <= 1 << 23

    def test_a_select_of_features(self, tmp_path):
        save(RECORDING, tmp_path / "a", format="lerobot", fps=20)
        found = read(tmp_path / "a", select="observation.touch")
        assert found.labels == ["fx", "fy", "fz", "mode"]

    @settings(max_examples=examples(60), deadline=None)
    @given(s.recordings().flatmap(s.clocked), st.integers(1, 5))
    def test_any_recording_comes_back(self, tmp_path_factory, recording, window):
        assume(recording.channels)
        rate = recording[0].rate_exact
        recording = recording.sel([i for i, c in enumerate(recording) if c.rate_exact == rate])
        root = tmp_path_factory.mktemp("law") / "a"
        try:
            save(recording, root, format="lerobot", fps=rate / window, max_memory=1 << 20)
        except LimitError as error:
            assert "the gaps take" in str(error)
            return
        except ParameterError as error:
            assert any(
                text in str(error) for text in ("beyond 2^53", "a rate is", "without samples")
            )
            return
        found = read(root)
        assert [*map(facts, found)] == [
            facts(replace(c, label=n)) for c, n in zip(recording, found.labels, strict=True)
        ]
        assert found.events == recording.events and found.clocks == recording.clocks
        assert found.clock_maps == recording.clock_maps and found.epoch_ns == recording.epoch_ns

    def test_refused(self, tmp_path):
        def refused(recording: Recording, message: str, **options: Any) -> None:
            with pytest.raises(HapfmtError, match=message):
                save(recording, tmp_path / "a", format="lerobot", **options)
            assert list(tmp_path.iterdir()) == []

        refused(RECORDING, r"several rates \(20 Hz, 1000 Hz, 8000 Hz\); .* such as 20 \(fps=\)")
        refused(RECORDING, r"30 frames per second do not divide the rates .*; 20 or", fps=30)
        refused(Recording(), "without channels")
        refused(Recording((Channel(np.empty(0), 10),)), "without samples")
        far = Channel(np.array([2**60, 1]), 10, (Span(0, 1), Span(3, 4)), label="far")
        refused(Recording((far,)), r"'far' has gaps.*2\^53")
        late = Channel(np.array([1.0, 2.0]), 10, (Span(0, 1), Span(1 << 40, (1 << 40) + 1)))
        refused(Recording((late,)), r"the gaps take .*\(max_memory=\)")
        wide = Recording((Channel(np.arange(99_999.0), 20_000),))
        refused(wide, r"20000 numbers, more than 16384; .*\(fps=\)", fps=1)
        with pytest.raises(ParameterError, match="needs a path"):
            save(RECORDING, io.BytesIO(), format="lerobot", fps=20)

    def test_folders_are_replaced_whole(self, tmp_path):
        root = tmp_path / "a"
        save(RECORDING, root, format="lerobot", fps=20)
        with pytest.raises(ParameterError, match="already exists"):
            save(RECORDING, root, format="lerobot", fps=20)
        save(RECORDING.sel([0]), root, format="lerobot", force=True)
        assert read(root).labels == ["fx"] and len(list(tmp_path.iterdir())) == 1

    def test_other_folders_are_never_replaced(self, tmp_path):
        (tmp_path / "thesis.txt").write_text("years", "utf-8")
        with pytest.raises(ParameterError, match="holds other files than LeRobot"):
            save(RECORDING, tmp_path, format="lerobot", fps=20, force=True)
        assert (tmp_path / "thesis.txt").read_text("utf-8") == "years"
        (tmp_path / "empty").mkdir()
        save(RECORDING, tmp_path / "empty", format="lerobot", fps=20, force=True)
        assert len(read(tmp_path / "empty")) == 6

    def test_fps_that_is_no_integer(self, tmp_path):
        recording = Recording((Channel(np.arange(110.0), Fraction(44100, 7)),))
        notes = save(recording, tmp_path / "a", format="lerobot", fps=Fraction(4410, 7))
        assert notes == ()
        notes = save(recording, tmp_path / "b", format="lerobot", fps=Fraction(44100, 77))
        assert notes == ("LeRobot expects a whole number of frames per second, not 6300/11",)
        assert read(tmp_path / "b")[0].rate_exact == 6300


# Untrusted folders


def parts_of(root: Path) -> Iterator[Path]:
    return (path for path in sorted(root.rglob("*")) if path.is_file())


DAMAGES = 20 if DEEP else 4


class TestHostile:
    @pytest.mark.parametrize("make", [v2, v3, None])
    def test_any_damage_gives_a_recording_or_our_error(self, make, tmp_path):
        root = tmp_path / "a"
        if make is None:
            save(RECORDING.sel([0, 1, 3, 5]), root, format="lerobot", fps=20)
        else:
            make(root)
        rng = np.random.default_rng(3)
        for path in parts_of(root):
            whole = path.read_bytes()
            damaged = [whole[:size] for size in range(0, len(whole), max(1, len(whole) // 4))]
            for _ in range(DAMAGES):
                at = int(rng.integers(len(whole)))
                changed = bytes(rng.integers(0, 256, int(rng.integers(0, 3)), dtype=np.uint8))
                damaged.append(whole[:at] + changed + whole[at + 1 :])
            for data in damaged:
                path.write_bytes(data)
                self.survives(root)
            path.unlink()
            self.survives(root)
            path.write_bytes(whole)

    @staticmethod
    def survives(root: Path) -> None:
        try:
            read(root, episode=0, limits=hapfmt.Limits(memory=1 << 22))
        except (HapfmtError, OSError) as error:
            assert str(error)

    @pytest.mark.parametrize(
        "pattern",
        ["../{chunk_index}/x", "/etc/passwd", "C:/x", "a\\b", "{0}", "{chunk_index.__class__}",
         "{chunk_index:0999999999d}", "{other}", "x" * 2000, 5, None, "{chunk_index!r}", "{"],
    )  # fmt: skip
    def test_paths(self, tmp_path, pattern):
        root = v3(tmp_path / "a")
        write_info(root, codebase_version="v3.0", data_path=pattern)
        with pytest.raises(ParameterError, match="data_path does not name a file of the dataset"):
            read(root, episode=0)

    @pytest.mark.parametrize(
        ("about", "message"),
        [
            ({"codebase_version": "v1.6"}, "version 'v1.6'; hapfmt reads v2.0 to v3.0"),
            ({"codebase_version": None}, "version 'None'"),
            ({"codebase_version": "v4.0"}, "version 'v4.0'"),
            ({"fps": True}, "no fps"), ({"fps": None}, "no fps"), ({"fps": 0}, "rate"),
            ({"fps": -5}, "rate"), ({"fps": "1e999999"}, "rate"), ({"fps": 1e400}, "rate"),
            ({"features": []}, "no features"), ({"features": {"a": 5}}, "no features"),
            ({"features": {}}, "no features of numbers"),
        ],
    )  # fmt: skip
    def test_info(self, dataset, about, message):
        path = dataset / "meta/info.json"
        known = json.loads(path.read_text("utf-8"))
        path.write_text(json.dumps({**known, **about}), "utf-8")
        with pytest.raises(ParameterError, match=message):
            read(dataset, episode=0)

    @pytest.mark.parametrize(
        "text", ["5", "[", "[" * 100_000, "{" * 100_000, "", "\0", '{"a": NaN}']
    )
    def test_texts(self, dataset, text):
        names = ["info.json"]
        names += (
            ["episodes.jsonl", "tasks.jsonl"] if (dataset / "meta/tasks.jsonl").exists() else []
        )
        for name in names:
            path = dataset / "meta" / name
            known = path.read_bytes()
            path.write_text(text, "utf-8")
            if text or name != "tasks.jsonl":
                with pytest.raises(ParameterError):
                    read(dataset, episode=0)
            path.write_bytes(known)

    def test_a_large_text_is_not_read(self, tmp_path):
        root = v2(tmp_path / "a")
        with (root / "meta/episodes.jsonl").open("wb") as stream:
            stream.truncate(1 << 40)
        with pytest.raises(LimitError, match="more than"):
            read(root, episode=0)

    def test_rows_of_another_episode(self, tmp_path):
        root = v3(tmp_path / "a")
        path = root / "meta/episodes/chunk-000/file-000.parquet"
        table = pq.read_table(path)
        for name, wrong in (
            ("dataset_from_index", [1, 40, 90]), ("dataset_to_index", [40, 91, 97]),
            ("dataset_to_index", [40, 1 << 50, 97]), ("dataset_to_index", [40, 0, 97]),
            ("dataset_from_index", [-4, 40, 90]), ("data/chunk_index", [0, 1 << 61, 0]),
        ):  # fmt: skip
            place = table.column_names.index(name)
            pq.write_table(table.set_column(place, name, pa.array(wrong)), path)
            with pytest.raises((ParameterError, OSError)):
                read(root, episode=1)

    @pytest.mark.parametrize(
        "text",
        ["5", "[" * 100_000, '{"window": 0}', '{"window": 50, "channels": 4}',
         '{"window": 50, "channels": [1]}', '{"window": 50, "channels": []}',
         '{"window": 50, "channels": [{"number": 0, "dtype": "O"}]}',
         '{"window": 50, "channels": [{"number": -1, "dtype": "float64"}]}',
         '{"window": 50, "channels": [{"number": 0, "dtype": "float32"}]}',
         '{"window": 50, "channels": [{"number": 0, "dtype": "int32", "calibration": [0, 0, 0]}]}',
         '{"window": 50, "channels": [{"number": 0, "dtype": "int32", "counts": true}]}'],
    )  # fmt: skip
    def test_wrong_windows(self, tmp_path, text):
        root = tmp_path / "a"
        save(RECORDING.sel(["fy"]), root, format="lerobot", fps=20)
        table = data_of(root)
        field = table.schema.field(0).with_metadata({"hapfmt": text})
        pq.write_table(
            table.cast(table.schema.set(0, field)), root / "data/chunk-000/file-000.parquet"
        )
        with pytest.raises(ParameterError):
            read(root)

    @pytest.mark.parametrize(
        "change",
        [{"version": 2}, {"fps": "0"}, {"first_frame": -1}, {"first_frame": 1 << 61}, {"events": [5]},
         {"epoch_ns": "x"}, {"clocks": 5}],
    )  # fmt: skip
    def test_wrong_members(self, tmp_path, change):
        root = tmp_path / "a"
        save(RECORDING.sel(["fy"]), root, format="lerobot", fps=20)
        table = data_of(root)
        own = {**json.loads(table.schema.metadata[b"hapfmt"]), **change}
        pq.write_table(table.replace_schema_metadata({"hapfmt": json.dumps(own)}),
                       root / "data/chunk-000/file-000.parquet")  # fmt: skip
        with pytest.raises((ParameterError, LimitError)):
            read(root)

    @pytest.mark.capped
    def test_bombs(self, tmp_path):
        count = 3_000_000
        table = pa.table({"x": np.zeros(count), "episode_index": np.zeros(count, np.int64)})
        root = tmp_path / "a"
        v3(root, [table.slice(0, 1)], features={"x": {"dtype": "float64", **SCALAR}})
        pq.write_table(table, root / "data/chunk-000/file-000.parquet", compression="zstd")
        episodes = root / "meta/episodes/chunk-000/file-000.parquet"
        listed = pq.read_table(episodes)
        place = listed.column_names.index("dataset_to_index")
        pq.write_table(listed.set_column(place, "dataset_to_index", pa.array([count])), episodes)
        with pytest.raises(LimitError, match="more than the 1000000 allowed"):
            read(root, limits=hapfmt.Limits(memory=1_000_000))

    def test_files_that_were_not_fetched(self, tmp_path):
        root = v3(tmp_path / "a", [rows(0, [3])])
        path = root / "data/chunk-000/file-000.parquet"
        path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
        with pytest.raises(ParameterError, match=r"pointer of Git LFS; git lfs pull"):
            read(root)
        path.unlink()
        with pytest.raises(ParameterError, match=r"folder lacks a file: .*file-000\.parquet"):
            read(root)

    def test_no_dataset(self, tmp_path):
        (tmp_path / "a").mkdir()
        with pytest.raises(ParameterError, match=r"holds none of the files .*meta/info\.json"):
            read(tmp_path / "a")
        for place in (tmp_path / "a", b"abc"):
            with pytest.raises(ParameterError, match=r"a folder with meta/info\.json"):
                read(place, format="lerobot")

    def test_without_pyarrow(self, tmp_path, monkeypatch):
        root = v3(tmp_path / "a")
        monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[arrow\]"):
            read(root)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[arrow\]"):
            save(RECORDING, tmp_path / "b", format="lerobot", fps=20)


def test_commands(tmp_path):
    v3(tmp_path / "set")
    done = commands.run("info", "set", cwd=tmp_path)
    assert done.returncode == 1 and "choose one (--episode)" in done.stderr.decode()
    assert commands.run("encode", "set", "a.hapf", "--episode", "1", cwd=tmp_path).returncode == 0
    done = commands.run("convert", "a.hapf", "again", "--output-format", "lerobot", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found, back = read(tmp_path / "set", episode=1), read(tmp_path / "again")
    for x, y in zip(found, back, strict=True):
        assert x.samples().tobytes() == y.samples().tobytes() and x.rate_exact == y.rate_exact
    done = commands.run("convert", "set", "b.hapf", "--episode", "1", "--fps", "7", cwd=tmp_path)
    assert done.returncode == 1 and ".hapf files do not use fps" in done.stderr.decode()
    assert {path.name for path in tmp_path.iterdir()} == {"set", "a.hapf", "again"}
