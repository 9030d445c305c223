"""Device profiles as data: TOML -> Profile, counts -> reports, and which device a profile fits.

model.py     a profile, the layout of a report, and frames.
parse.py     TOML -> Profile, and the rules that it must satisfy.
packing.py   counts -> the bytes of reports.
matching.py  finds the device of a profile, and checks its report descriptor.
"""
