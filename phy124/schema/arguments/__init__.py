"""Reads the command line of any program, and refuses bad ones in plain sentences.

It knows no command: phy124's are in phy124/commands, the bridge's in bridge/commands.py.
"""
