"""Compares what hapf.ksy reads of files with what plain.py reads, field by field.

python conformance/kaitai/check.py [FILE ...]     without files: the vectors that keep every rule

Takes node with kaitai-struct-compiler and js-yaml, and kaitaistruct for Python:

npm install --prefix FOLDER kaitai-struct-compiler js-yaml;  export NODE_PATH=FOLDER/node_modules
"""

from __future__ import annotations

import enum
import importlib.util
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
import plain  # noqa: E402

PARAMETERS = {
    "Parameters": {"codec"}, "Contract": {"component_count"},
    "Observation": {"number"}, "Point": {"number"}, "Row": {"widths"},
}  # fmt: skip
"""What types are given, in place of what they read."""


class Missing(Exception):  # noqa: N818
    """The argument says what is not installed."""


def compiled() -> ModuleType:
    """hapf.ksy as a module of Python."""
    node = shutil.which("node")
    if node is None:
        raise Missing("node")
    if importlib.util.find_spec("kaitaistruct") is None:
        raise Missing("kaitaistruct")
    looking = "for (const name of ['kaitai-struct-compiler', 'js-yaml']) require.resolve(name)"
    if subprocess.run([node, "-e", looking], capture_output=True, check=False).returncode:
        raise Missing("kaitai-struct-compiler or js-yaml")
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([node, str(HERE / "compile.js"), "python", folder], check=True)
        spec = importlib.util.spec_from_file_location("hapf", Path(folder) / "hapf.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return module


def as_plain(value: Any) -> Any:
    if isinstance(value, list):
        return [as_plain(each) for each in value]
    if isinstance(value, enum.Enum):
        return value.value
    if not hasattr(value, "_io"):
        return value
    name = type(value).__name__
    if name in ("Varint", "Svarint", "Digits"):
        return value.value
    given = PARAMETERS.get(name, set())
    fields = {key: each for key, each in vars(value).items() if key[0] != "_" and key not in given}
    return {key: as_plain(each) for key, each in fields.items()}


def left_over(value: Any) -> Iterator[str]:
    """Types with bytes of their own that they did not read to the end."""
    if isinstance(value, list):
        for each in value:
            yield from left_over(each)
    elif hasattr(value, "_io"):
        own = value._parent is None or value._io is not value._parent._io
        if own and not value._io.is_eof():
            yield type(value).__name__
        for key, each in vars(value).items():
            if key[0] != "_":
                yield from left_over(each)


def differences(a: Any, b: Any, place: str = "file") -> Iterator[str]:
    """``a`` is Kaitai's."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in sorted(a.keys() ^ b.keys()):
            yield f"{place}.{key}: only in {'hapf.ksy' if key in a else 'SPEC.md'}"
        for key in a.keys() & b.keys():
            yield from differences(a[key], b[key], f"{place}.{key}")
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from differences(x, y, f"{place}[{i}]")
    elif a != b:
        yield f"{place}: {a!r}, by SPEC.md {b!r}"


def check(module: ModuleType, data: bytes) -> list[str]:
    found = module.Hapf.from_bytes(data)
    wanted = plain.parse(data)
    out = list(differences(as_plain(found), wanted))
    out += [f"{name}: bytes left over" for name in left_over(found)]
    kinds = {}
    for each in wanted["chunks"]:
        if each["header"]["type"] == "TRAK":
            tracks = each["payload"].get("tracks", {"tracks": []})["tracks"]
            for id_, track in enumerate(tracks, each["payload"]["first_track"]):
                kinds[id_] = track["kind"]
    for each in wanted["chunks"]:
        if each["header"]["type"] == "DATA":
            payload = each["payload"]
            for row, packet in zip(payload["rows"], payload["packets"], strict=True):
                if kinds.get(payload["least_track"] + row["track"]) == 3:
                    events = as_plain(module.Hapf.EventPacket.from_bytes(packet))
                    out += differences(events, plain.events(packet), "events")
    return out


DAMAGED = {"table"}
"""Examples with a table that cannot be read."""


def files() -> list[Path]:
    room = HERE.parent
    found = [path for path in sorted(room.glob("examples/*.hapf")) if path.stem not in DAMAGED]
    for name in ("valid", "uncommon"):
        found += sorted(room.glob(f"vectors/{name}/*.hapf"))
    return found


def main() -> int:
    try:
        module = compiled()
    except Missing as what:
        print(f"not installed: {what}")
        return 1
    paths = [Path(name) for name in sys.argv[1:]] or files()
    wrong = 0
    for path in paths:
        for line in check(module, path.read_bytes()):
            wrong += 1
            print(f"{path.name}: {line}")
    print(f"{len(paths)} files, {wrong} differences")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
