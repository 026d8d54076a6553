"""Names in the graph of a trial: executables, nodes, and topics that only nodes publish."""

#: Package and executable.
FILTER, TUNER = ("ros_insdvl", "filter"), ("ros_insdvl", "tuner")
SIMULATOR, RELAY = ("ros_insdvl_sim", "simulator"), ("ros_insdvl_sim", "relay")

FILTER_NODE, TUNER_NODE, RELAY_NODE = "/insdvl_filter", "/insdvl_tuner", "/insdvl_relay"

ODOMETRY, INNOVATION, BIAS = "odometry/filtered", "dvl/innovation", "imu/bias"
