"""What each flight controller firmware accepts, refuses and does by itself: PX4, ArduCopter, STM32."""
