"""Subjective tests of coded touch, as Brandi, Chaudhari and Steinbach made them (section IV, 2011,
DOI 10.1109/VECIMS.2011.6053837): people feel a reference and a condition, and say from 0 to 100
how near they are.

description.py  Study, from TOML; beginning.py writes one to edit
prepare.py      the conditions of a study as files, made once
order.py        what one subject feels, in which order
answers.py      one line after every answer, on the disk before the next question
rating.py       the questions, without a terminal
outputs.py      where it is felt: device, sound card, WAV, nowhere (sound.py: what a card gets)
summary.py      means, intervals, who is left out and why
"""
