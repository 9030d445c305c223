import sys

from .verbs import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
