"""hapfmt's adapter, wrong in one thing: python wrong_encoder.py DEED VERB ..."""

import json
import struct
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "conformance/adapters/python"))


def other_job(deed, path, folder):
    """The job as the encoder misreads it."""
    job = json.loads(path.read_text(encoding="utf-8"))
    (channel,) = job["channels"]
    data = (path.parent / channel["numbers"]).read_bytes()
    if deed == "one more":
        numbers = struct.unpack(f"<{len(data) // 8}q", data)
        data = struct.pack(f"<{len(numbers)}q", *(number + 1 for number in numbers))
    elif deed == "no gap":
        channel["spans"] = [[0, len(data) // 8]]
    elif deed == "no label":
        del channel["label"]
    elif deed == "wide":
        job["k"] = [1, 2]
    elif deed == "random id":
        del job["file_id"]
    (folder / channel["numbers"]).write_bytes(data)
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    return folder / "job.json"


def encode(deed, job, target):
    if deed == "refuse":
        return 4
    if deed == "no file":
        return 0
    from hapfmt_adapter.verbs import main

    from hapfmt.format.walk import FOOT_SIZE
    from hapfmt.writing import filewriter

    build = filewriter.build_index
    if deed == "no index":
        filewriter.build_index = lambda index: build(index._replace(entries=index.entries[:-1]))
    with tempfile.TemporaryDirectory() as folder:
        code = main(["encode", str(other_job(deed, Path(job), Path(folder))), target])
    filewriter.build_index = build
    if deed == "no footer":
        path = Path(target)
        path.write_bytes(path.read_bytes()[:-FOOT_SIZE])
    return code


if __name__ == "__main__":
    deed, verb, *arguments = sys.argv[1:]
    if verb == "capabilities":
        told = {"name": "wrong", "version": "1", "format": "1.0", "level": 2, "verbs": ["encode", "serve"], "codecs": [], "parts": [], "presets": ["lossless", "deadband", "split"]}  # fmt: skip
        print(json.dumps(told))
        sys.exit(0)
    for line in sys.stdin:  # the verb serve
        print(encode(deed, *json.loads(line)[1:]), flush=True)
