"""Which knots, which step, which codec. Nothing on the decode side imports this package.

Where things are, in the order of the work:

* settings.py: what the caller asks for; tolerance.py: amounts; perception.py: constants of touch.
* plan.py makes a promise for each channel: a preset is a function from channel to promise.
* gridded.py puts floating point channels on a grid that the promise allows. lattice.py searches
  the step, by rational.py, common_step.py and near.py. exact.py (LPCX) and words.py (RAWB) store
  what has no common step.
* groups.py: axes of one vector. source.py: channels side by side, cut into packets. packed.py: a
  track in the making.
* encode.py takes a recording to tracks, packets and decisions, and keeps the lossless form where a
  lossy one is not smaller. check.py decodes the result and measures the largest errors.
* bounded.py keeps a bound on every sample: grids.py; predict.py, or quick.py with --fast, for LPCR;
  tubed.py for knots (tube.py and sweep.py, vectors.py for several axes).
* texture.py keeps a texture to a stated quality: split.py.
* unit.py is the paper's method: split.py, knots.py, codebook.py.
* live.py codes blocks as they arrive, by the same functions. live_plan.py: what is known before the
  first sample. live_exact.py: channels of floating point numbers.
* references.py joins channels that resemble each other in one track; weights.py fits them.
"""
