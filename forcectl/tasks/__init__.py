"""Control of robot motion by prioritized tasks (Chapter 5)."""
