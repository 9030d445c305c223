"""Packets <-> counts, normative both ways where the bits are fixed (SPEC clause 9).

* KNOT: knots.py. QUAN: quantised.py. RAWB: raw.py. EVNT: events.py.
* LPCR: predicted.py, with its grids of counts in grids.py.
* LPCX: exact.py.
* MDCT: transform.py. NOIS: noise.py.
* entropy.py is the entropy coder of 9.4.
"""
