"""What a device takes, as data: TOML -> Profile, counts -> reports, which device it fits.

layout.py    the bytes of a report         model.py   a profile
parse.py     TOML -> profile                rules.py   what must hold
maps.py      counts -> odd bytes           packing.py counts -> reports
"""
