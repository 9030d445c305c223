"""Recordings of any length looked at in parts: what a picture shows of them, and how two differ.

Memory is that of one part and of a picture's columns, however long the recording is.
"""
