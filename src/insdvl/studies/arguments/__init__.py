"""The arguments of each command. Modules here import no more than the standard library.

So a help and a wrong call are answered at once; `insdvl.commands` says which command has which.
"""
