"""The text of the page, and what follows from the committed numbers, written by hand."""

QUESTION = """
How near does a filter that learns the noise of its DVL come to one that is told it? And does it
still learn where something else is wrong too: pings that are off, or the process noise?
"""

DEFINITIONS = """
An AUV has an IMU with constant white noise: of a tactical grade, with a DVL of 5 Hz, in
`bottom-tactical`, and a FOG, with a DVL of 1 Hz, in `bottom-fog`
([effective-noise.md](../explanation/effective-noise.md#8-scenarios)). The sigma of the DVL is
50 mm/s on its data sheet; the true one is 7 to 200 mm/s, new every 15 to 45 s.

`R nominal` has the R of the data sheet, `R learned` and `R adaptive` have that source of R
([measurement-noise.md](../explanation/measurement-noise.md)). In the rows *received* the factor
that the tuner publishes is in the place of the own window's. *With factor* has
`process_noise.adaptive_factor`
([process-noise-factor.md](../explanation/process-noise-factor.md)). `R oracle` is told the variance
of each ping. A row fails in a mission where its body velocity is off by more than 5 m/s for 10 s.

All rows are told the true Q, or a hundredth of it, or a hundred times as much. With *outliers* one
ping in twenty is off by 1 m/s in a random direction, and no row is told which; with *outliers left
out* these pings are missing. The ratio of the two shows what the outliers do. The ratio to the same
row with the gate off also shows what the lost pings cost. All conditions of a vehicle have the same
missions and the same noise, so ratios of two conditions are paired by mission as well.

The target for outliers was judged by two stand-ins at first, the oracle with the same outliers and
the run with the gate off, and missed; then by its own words, the run without those pings, and the
gate was changed after these missions had been seen.
[measurement-noise.md](../explanation/measurement-noise.md#9-measured) has the same ratios on
missions that had not.
"""

#: A test holds each number of it against the committed JSON file.
CONCLUSION = """
Told the true Q, `R adaptive` has 1.019 of the oracle's error at 5 Hz and 1.057 at 1 Hz, where `R
nominal` has 1.123 and 1.170. It meets both targets, with the factor and without. `R learned` has
1.073 and 1.164, and misses both. The gate changes the error of these rows by 0.1 % at most. The
gate of `R nominal` refuses good pings above a bad bottom: it has 0.0239 and 0.0462 m/s, in place of
0.0187 and 0.0332 m/s with the gate off. At 1 Hz that is a few missions that are half lost: the
medians are 0.0218 and 0.0345 m/s, in place of 0.0184 and 0.0322 m/s. With outliers `R adaptive` has
1.027 and 1.017 of its error without those pings, and the oracle 1.020 and 1.013. The target of 1.05
is met at 1 Hz, and missed at 5 Hz by the end of the interval, 1.062. One mission makes it, whose
second and third ping are off, when nothing has borne the filter out yet: without it the ratio is
1.010. Over the run with the gate off, which has lost no ping, the outliers cost more: 1.044 and
1.046. With a wrong Q it meets the target everywhere: with a hundredth of Q at 5 Hz it has 0.986 of
the error of `R nominal`, and 0.942 with the factor. There `R learned` has 1.007, and misses it at
the end of the interval.
"""
