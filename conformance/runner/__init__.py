"""What conformance/run.py consists of. Standard library only; knows no implementation."""
