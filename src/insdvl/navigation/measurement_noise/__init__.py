"""The noise of a measurement, estimated while the filter runs.

The estimate is one factor on the nominal covariance: what makes a DVL better or worse (height,
speed, bottom) acts on all of its components alike. Derivations, numbers and limits are in
docs/explanation/measurement-noise.md.

- levels.py: the factor by the probabilities of its levels, from each innovation;
- window.py: the factor from the pings and the IMU between them, without the filter's Q;
- guard.py: how far the first may be believed, given the second;
- source.py: all of it on the state record.
"""
