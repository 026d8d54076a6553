"""The command `insdvl results`: the studies behind docs/results.md, and the page itself."""
