"""What the streams themselves tell: whether axes and units fit, and whether samples are missing."""
