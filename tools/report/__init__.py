"""One report: error, size and run time of everything, side by side. Begin with section.py."""
