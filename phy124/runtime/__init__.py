"""Serves the whole process: starts Warp, handles signals, measures times, and runs work that can be
killed.
"""
