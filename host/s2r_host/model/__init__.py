"""From an estimated joint and two clouds to a loadable physics model."""
