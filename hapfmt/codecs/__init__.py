"""Packets <-> counts, normative both ways where the bits are fixed (SPEC clause 9).

* KNOT: knots.py. QUAN: quantised.py, huffman.py, bits.py. RAWB: raw.py.
* LPCR: components.py cuts a packet into component packets, references.py says what they tell of
  each other, predicted.py is one of them; grids.py and sine.py are its grids and its table.
* LPCX: exact.py, values.py.
* entropy.py is the coding of 9.4; varints.py reads and writes many numbers at once.
"""
