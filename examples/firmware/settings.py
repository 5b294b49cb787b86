"""Settings of one robot. Every robot has its own number, which is that of its marker."""

ROBOT = 0
UDP_PORT = 9000
BROKER = "192.168.0.2"
TOPIC = f"skyherd/robots/{ROBOT}/cmd_vel"
WIFI = "name", "password"
