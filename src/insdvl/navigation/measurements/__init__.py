"""What sensors measure: one file per kind, each by the protocol of base.py."""
