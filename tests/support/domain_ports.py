"""UDP ports that two runs of the tests do not share."""


def first_port(domain):
    """Of 70 UDP ports that only the holder of the domain uses.

    DDS keeps 250 for each domain, and its processes take two each of the first ones. The vehicles of a bridge that
    listens at a port send from 40 above it.
    """
    return 7400 + 250 * domain + 180
