"""The ROS 2 nodes of a vehicle: message -> event -> core -> message.

`filter`, `tuner` and `monitor` are the nodes. `node` is what they share: parameters (`parameters`),
counted topics (`endpoints`, `qos`) and statuses (`status`); `execution` runs one as a process.
"""
