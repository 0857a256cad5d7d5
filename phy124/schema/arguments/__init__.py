"""Parse the command line of any program; errors are plain sentences.

The commands themselves are in phy124/commands and bridge/commands.py.
"""
