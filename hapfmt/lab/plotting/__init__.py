"""Pictures. matplotlib is imported here alone, and only when one is drawn, through its object
interface: no window unless one is asked for, no global state."""
