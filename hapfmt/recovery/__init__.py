"""A damaged file -> one that is intact, with all that reading the damaged one delivers (SPEC 12.3).

``recover`` reads ``descriptions`` (what tracks there are), copies ``packets``, carries ``extras``
(metadata, attachments, unknown chunks, digests), and says what was lost; ``inplace`` repairs a
file in place.
"""
