"""Services that rclpy gives a node of ours, by what they are for."""

PARAMETERS = {
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
}
