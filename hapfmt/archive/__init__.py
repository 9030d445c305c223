"""Folders of recordings: work on many files, a catalogue of their channels, bags for archives.

Every file has a job of its own, which turns all of its errors into an outcome. Jobs run in this
process or on a Dask cluster. A log lets an interrupted run go on where it stopped.
"""
