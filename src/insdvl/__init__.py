"""The navigation core: an INS/DVL error-state filter with learned process noise, free of ROS.

Rooms, lowest first; a room imports only from those above it in this list:

===============  ===================================================================================
``parameters``   declaration of parameters, and parameter files of ROS 2
``navigation``   one vehicle: state, strapdown, error state, measurements, gate, filter, odometry
``timeline``     the order of events: samples, time jumps, the fold over them, its state file
``messages``     the topics and the meaning of their messages; the loop that feeds the filter
``tuner``        learned process noise: windows of IMU samples, features, models
``watch``        checks of the streams themselves: axes, units, missing samples
-- ashore --     what never runs on a vehicle
``recordings``   rosbag2 recordings: reading, writing, checks
``simulation``   trajectories, and what the sensors of a vehicle on them read
``jobs``         many runs on many processors
``studies``      replay, training, evaluation, consistency, faults, and the pages made from them
===============  ===================================================================================

Beside them are arrays.py (array types), kernels.py (compilation), files.py and yaml_files.py (files
within limits), extras.py (packages that only some uses need), terminal.py (what people read there),
commands.py and cli.py (the command).

Names are those of the field. ``C_n_b`` rotates from b to n; ``v_n`` is a vector in the axes n;
``w_ib_b`` is the angular rate of b against i in the axes b; ``l_b_dvl`` is the position of the DVL
in b. Axes: i inertial, e Earth, n north-east-down, b base_link forward-right-down, d the DVL.
docs/reference/naming.md lists all names.

Units are SI, angles radians; any other unit is the end of the name (``latitude_deg``). Stamps are
integer nanoseconds (``_ns``). An IMU sample is the mean over the interval that ends at its stamp.

Axes of ROS (REP-103: east-north-up, forward-left-up) occur in ``messages`` and in the output only;
`navigation.geometry.frames` converts.

A recording is navigated in five lines::

    from pathlib import Path

    from insdvl.messages.feed import Feed
    from insdvl.navigation.parameters import FilterParameters
    from insdvl.parameters.sections import load_section
    from insdvl.recordings.bag_reader import BagReader

    feed = Feed(load_section(Path("vehicle.yaml"), "insdvl_filter", FilterParameters))
    with BagReader(Path("dive")) as bag:
        for recorded in bag.messages(["/imu/data_raw", "/dvl/velocity"]):
            feed.give(recorded.topic.lstrip("/"), recorded.message)
    print(feed.fold.take()[-1])

The result is the odometry at the last sample; ``take()`` returns that of every sample, and each
measurement with its innovation. docs/explanation/architecture.md follows a message on its way.
"""

__version__ = "0.1.0"
