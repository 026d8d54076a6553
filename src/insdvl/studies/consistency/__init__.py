"""Is the filter as good as it says? Missions of known truth, many of each, against its sigmas.

A study is a `study.Study` in the list `page.STUDIES`: how it is computed, and its section of
docs/results/consistency.md.
"""
