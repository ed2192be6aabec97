"""What is asked of the machine: devices, threads, memory, and files that appear whole or not at all."""
