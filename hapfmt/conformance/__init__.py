"""hapfmt as the conformance suite drives it: the verbs of conformance/README.md.

``python -m hapfmt.conformance VERB ...``; nothing is loaded that the verb does not need.
"""
