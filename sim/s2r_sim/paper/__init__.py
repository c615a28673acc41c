"""The paper's accuracy table (Table I), redone on concealed stand-in objects through the whole system."""
