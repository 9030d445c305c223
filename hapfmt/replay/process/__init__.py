"""The processes of a replay: player, writer, watchdog; and a replay without any.

player.py    feeds the writer, stops it, reports       feeding.py  what it renders ahead
writing/writer.py    opens the device; loop.py sends frames    guard.py    the watchdog, as it sees it
watchdog.py  neutral frames when the writer is gone    virtual.py  no device, no real time
messages.py  what passes between them, blocks.py with arrays, pipes.py through which
clock.py  realtime.py  children.py  keys.py  report.py
"""
