"""What a user could take in place of hapfmt, each where its package is installed.

packages.py what is installed; exact.py coders of integers and of doubles, without loss; relative.py
recipes for the deadband; zipped.py a whole file of what they give.
"""
