"""The hover test of one vehicle: how it follows a velocity, and the settings of the formation that follow from it."""
