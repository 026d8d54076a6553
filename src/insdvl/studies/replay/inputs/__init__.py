"""What is told to a replay beside the recording: added noise, a learned Q, mounts from /tf."""
