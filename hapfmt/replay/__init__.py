"""Replay of recordings on devices (docs/spec/players.md).

profile/      device profiles: the reports of a device, and the limits it must never exceed.
render/       file -> values at the device's rate, only for channels and bands it can render.
schedule.py   values -> the frame that is due: calibrated, clamped, ramped, slew-limited. Pure.
sinks/        destinations of frames: hidapi, a recording, a dry run, a loopback.
process/      the writer, its watchdog, and the player that feeds and stops them.
"""
