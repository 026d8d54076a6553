"""What the streams themselves show: whether axes and units fit, and whether samples are missing."""
