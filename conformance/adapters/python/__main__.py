"""hapfmt as the conformance suite drives it: python conformance/adapters/python VERB ..."""

import sys

from hapfmt_adapter.verbs import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
