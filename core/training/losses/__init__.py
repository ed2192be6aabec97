"""What a step minimises, loss by loss, and how their gradients are taken."""
