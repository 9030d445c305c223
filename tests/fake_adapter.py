"""An adapter that answers as told, and that misbehaves as told: python fake_adapter.py FOLDER VERB ...

FOLDER/answers.json: ``capabilities``; ``decode``, ``verify`` what is written; ``raw`` {name: numbers};
``exit`` {verb: code}; ``deed`` {verb: what it does instead}.
"""

import json
import os
import struct
import sys
import time
from pathlib import Path


def misbehave(deed):
    if deed == "hang":
        time.sleep(600)
    if deed == "crash":
        os.abort()
    if deed == "grow":
        room = []
        while True:
            room.append(bytearray(b"x" * (1 << 22)))
            time.sleep(0.001)
    if deed == "peak":  # over before anybody looks
        bytearray(b"x" * (400 << 20))
    if deed == "shout":
        sys.stderr.write("first\nwhat went wrong\n")


def write(verb, arguments, answers):
    if verb == "decode":
        out = Path(arguments[1])
        for name, numbers in answers.get("raw", {}).items():
            form = "Q" if any(number > 1 << 62 for number in numbers) else "q"
            (out / name).write_bytes(struct.pack(f"<{len(numbers)}{form}", *numbers))
        path = out / "decode.json"
    else:
        path = Path(arguments[-1])
    if verb == "recover":
        Path(arguments[1]).write_bytes(Path(arguments[0]).read_bytes())
    answer = answers.get({"recover": "verify"}.get(verb, verb))
    if answer is not None:
        text = answer if isinstance(answer, str) else json.dumps(answer)
        path.write_text(text, encoding="utf-8")


def run(folder, verb, *arguments):
    answers = json.loads((folder / "answers.json").read_text(encoding="utf-8"))
    (folder / "calls.txt").open("a", encoding="utf-8").write(f"{os.getpid()} {verb}\n")
    misbehave(answers.get("deed", {}).get(verb))
    if verb == "capabilities":
        print(json.dumps(answers["capabilities"]))
        return 0
    write(verb, arguments, answers)
    return answers.get("exit", {}).get(verb, 0)


def main(folder, verb, *arguments):
    if verb != "serve":
        return run(folder, verb, *arguments)
    for line in sys.stdin:
        print(run(folder, *json.loads(line)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), *sys.argv[2:]))
