"""Names in the graph of a trial: executables, nodes and topics."""

#: Package and executable.
FILTER, TUNER = ("ros_insdvl", "filter"), ("ros_insdvl", "tuner")
SIMULATOR, RELAY = ("ros_insdvl_sim", "simulator"), ("ros_insdvl_sim", "relay")

FILTER_NODE, TUNER_NODE, RELAY_NODE = "/insdvl_filter", "/insdvl_tuner", "/insdvl_relay"

IMU, DVL, Q = "imu/data_raw", "dvl/velocity", "process_noise"
TRUTH, TRUE_Q = "ground_truth/odometry", "ground_truth/process_noise"
ODOMETRY, INNOVATION, BIAS = "odometry/filtered", "dvl/innovation", "imu/bias"
