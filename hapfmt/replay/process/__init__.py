"""The processes of a replay: player, writer, watchdog."""
