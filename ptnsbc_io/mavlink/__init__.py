"""MAVLink 2, dialect `common`: frames, links, signing, time, parameters. No ROS in here."""
