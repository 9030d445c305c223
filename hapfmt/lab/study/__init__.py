"""Subjective tests of coded touch, as in section IV of Brandi, Chaudhari and Steinbach (2011, DOI
10.1109/VECIMS.2011.6053837). Subjects feel a reference and a condition, and rate their similarity
from 0 to 100.

description.py  TOML -> Study; also writes a study file to edit.
prepare.py      encodes the conditions of a study to files, once.
rating.py       the trials of one subject: their order, the questions, the answer file.
outputs.py      plays stimuli: device, sound card, WAV, or none.
summary.py      means, confidence intervals, excluded subjects and why.
"""
