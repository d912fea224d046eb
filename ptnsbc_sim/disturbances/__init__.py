"""Random disturbances: noisy and late positions, gusts, lost messages. All of it follows from the seed."""
