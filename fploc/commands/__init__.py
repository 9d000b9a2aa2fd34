"""The sub-commands of ``fploc``, one module each: what it means, its parser, what it does.

Everything heavy is imported by the function that needs it: help and completion answer at once.
"""
