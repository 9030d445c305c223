"""The paper's Fig. 4: compression ratio against the Weber fraction k, for residuals of b bits.

python tools/ratio.py [RECORDING.npz CHANNEL]     without: the simulated textures
"""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from fractions import Fraction

import numpy as np
from measured import DATA, print_origin, print_table

import hapfmt
from hapfmt.metrics import snr_hf_db
from hapfmt.scenes.stylus import simulate

WEBER = (1, 2, 5, 10, 15, 20, 30, 40, 50)
BITS = (0, 2, 5, 8)
SECONDS = 11.0
"""Length of the paper's sessions."""


def measure(name: str, recording: hapfmt.Recording, floor: str) -> None:
    from hapfmt.encoder.tolerance import Tolerance

    rows = []
    samples = recording.sample_count
    for percent in WEBER:
        row: list[object] = [percent]
        for bits in BITS:
            settings = hapfmt.Settings.of(
                "paper", k=Fraction(percent, 100), bits=bits, floor=Tolerance.parse(floor)
            )
            stream = io.BytesIO()
            summary = hapfmt.write(recording, stream, settings, canonical=1)
            back = hapfmt.read(stream.getvalue())
            snr = np.median(
                [
                    snr_hf_db(a.physical(), b.physical(), float(a.rate))
                    for a, b in zip(recording.channels, back.channels, strict=True)
                ]
            )
            payload = 100 * (1 - summary.payload_size / (8 * samples))
            whole = 8 * samples / summary.file_size
            row += [f"{payload:.2f}", f"{whole:.1f}", f"{snr:.1f}"]
        rows.append(row)
    print(f"{name}: {len(recording)} channels, {samples} samples, floor {floor}")
    print("reduction % of 64-bit samples (packets), ratio (whole file), HF SNR dB (median)\n")
    headers = ["k %"]
    for bits in BITS:
        word = f"b={bits or 'none'}"
        headers += [f"{word} red.", "ratio", "SNR"]
    print_table(headers, rows)


def main() -> None:
    print_origin()
    if len(sys.argv) > 1:
        recording = hapfmt.load(sys.argv[1])
        if len(sys.argv) > 2:
            recording = replace(recording, channels=(recording.channel(sys.argv[2]),))
        measure(sys.argv[1], recording, "0.2%")
        return
    for texture in ("sand", "stone", "cork"):
        measure(texture, simulate(texture, SECONDS), "0.01")
    foam = DATA / "teleop1dof" / "question1a_foam.npz"
    if foam.exists():
        recording = hapfmt.load(foam)
        forces = tuple(c for c in recording.channels if c.unit == "N.m")
        measure("question1a_foam, torques", replace(recording, channels=forces), "0.2%")


if __name__ == "__main__":
    main()
