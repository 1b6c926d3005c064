"""ROS 2 without ROS: its messages as bytes, and the keys under which two kinds of Zenoh carry them."""
