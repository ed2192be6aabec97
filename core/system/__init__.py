"""What concerns the machine: devices, threads, memory, locks, and files that appear whole or not at all."""
