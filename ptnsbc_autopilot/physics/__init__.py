"""The vehicle under a stand-in flight controller: plant, control loops, positioning, frames. No MAVLink."""
