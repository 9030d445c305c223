"""The processes of a replay: player, writer and watchdog; also a replay without processes.

player.py    renders ahead, feeds the writer, stops it, reports; the keys of the terminal.
writer.py    opens the device and runs loop.py.
loop.py      sends frames when they are due, in real time or on a virtual clock; the report.
watchdog.py  sends neutral frames when the writer fails; also the writer's side of the watchdog.
pipes.py     messages between the processes, and their arrays.
children.py  starts the processes and requests real-time settings.
"""
