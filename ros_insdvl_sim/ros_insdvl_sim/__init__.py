"""The ROS 2 nodes and trials of a desk.

`simulator` and `replay` are nodes that play messages (`player`), `relay` is a bad network. `trials`
runs whole graphs of processes: the demo, the fault rows and the soak.
"""
