"""`ptnsbc bridge`: one flight controller on the topics of one UAV."""
