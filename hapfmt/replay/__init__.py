"""Recordings played on devices (docs/spec/players.md).

profile/      what a device takes, and what it must never be given
render/       file -> values at the device's rate, only the channels and bands it can render
schedule.py   values -> the frame that is due: calibrated, clamped, ramped, slew-limited; pure
sinks/        where frames go: hidapi, a recording, a dry run, a loopback
process/      the writer, its watchdog, and the player that feeds and stops them
"""
