"""The processes of a replay: player, writer, watchdog; and a replay without any.

player.py    renders ahead, feeds the writer, stops it, reports
writer.py    opens the device; loop.py sends frames, on a virtual clock too
watchdog.py  neutral frames when the writer is gone, and the watchdog as the writer sees it
pipes.py     messages between the processes, and their arrays
children.py  how the processes start, and what lets them be on time
keys.py  report.py
"""
