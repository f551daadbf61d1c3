"""What flows and where: messages, topics, the robot's body, time and plane geometry. Imports nothing of robotd."""
