"""What a device takes, as data: TOML -> Profile, counts -> reports, which device it fits."""
