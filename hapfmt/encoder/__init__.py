"""The encoder: it chooses knots, steps and codecs. Nothing on the decode side imports this package.

The files, in the order of the work:

* settings.py: what the caller asks for; amounts (10mN, 0.1%); the constants of touch.
* plan.py makes a promise for each channel: a preset is a function from channel to promise.
* gridded.py puts floating point channels on a grid that the promise allows. lattice.py searches
  the step, with rational.py. exact.py stores floating point channels without a common step, as
  LPCX or RAWB, and finds channels that are linear in others.
* source.py: the axes of one vector; channels in one block, cut into packets.
* encode.py turns a recording into tracks, packets and decisions. It keeps the lossless form where
  a lossy one is not smaller. unit.py decodes the result and measures the largest errors.
* bounded.py keeps a bound on every sample: predict.py for LPCR and its packet lengths, tube.py for
  knots.
* texture.py keeps a texture to a stated quality: split.py. synthetic.py stores a model of it.
* unit.py is the paper's method: split.py and knots.py.
* live.py codes blocks as they arrive, with the same functions.
* references.py joins channels that resemble each other in one track, and fits the weights.
"""
