"""Many runs on many processors."""
