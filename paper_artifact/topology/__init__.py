"""Alpha persistence with gradients, the topology loss, its plan, target bundle and conditions; usable without scene or trainer."""
