"""The command line: a module a group of commands, which compose rigs, store and service.

Imports stand where they are used: `calrig --help` needs none of them.
"""
