"""The two versions: of the package, and of the format that it writes."""

__version__ = "0.1.0"
SPEC_VERSION = "1.0"
