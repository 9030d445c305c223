"""One opinion: which knots, which step, which codec. Nothing on the decode side comes here.

Where things live, in the order of the work:

* encode.py takes a recording to tracks and packets; settings.py is what the caller asks of it,
  tolerance.py an amount of it, perception.py the defaults, auto.py is preset auto.
* Doubles to counts: lattice.py finds the step, by rational.py, common_step.py and near.py; exact.py
  (LPCX) and words.py (RAWB) take what is on no lattice.
* groups.py: axes of one vector. source.py: channels side by side, cut into packets. packed.py: a
  track in the making. check.py: what the decoder makes of it.
* unit.py codes a unit by presets default and paper: split.py, knots.py, codebook.py.
* indexed.py codes it by those that keep a bound by construction: grids.py; predict.py, or quick.py
  with --fast, for LPCR; tubed.py for knots (tube.py and sweep.py, vectors.py for several axes).
* live.py: blocks as they arrive. live_plan.py is what is known before the first sample; channels
  are of the kinds of live_counts.py, live_deadband.py and live_exact.py; live_many.py packs many
  blocks in one call, live_knots.py those of knots.
* references.py joins channels that resemble each other in one track; weights.py fits them.
"""
