"""The operator's page: a web server, its maps, and who may drive. It needs no ROS."""
