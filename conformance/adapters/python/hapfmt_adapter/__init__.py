"""The verbs of conformance/README.md. Nothing is loaded that the verb does not need."""
