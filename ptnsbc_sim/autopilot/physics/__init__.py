"""The vehicle under a stand-in flight controller: plant, inner loops, positioning, frames. No MAVLink."""
