"""The rules of each firmware: what PX4, ArduCopter and STM32 accept, refuse and do without a command."""
