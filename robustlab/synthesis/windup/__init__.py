"""Controllers whose actuators saturate."""
