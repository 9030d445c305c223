"""Recordings of any length, examined in parts: their pictures, and how two of them differ.

Memory is bounded by one part and the columns of a picture, for any length of recording.
"""
