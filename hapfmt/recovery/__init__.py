"""A damaged file -> an intact one with all that can be read of it (docs/spec/recovery.md).

``recover`` reads ``descriptions`` (what tracks there are), copies ``packets``, carries ``extras``
(metadata, attachments, unknown chunks, digests), and says what was lost; ``inplace`` repairs a
file in place.
"""
