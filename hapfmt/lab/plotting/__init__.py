"""Pictures. Only this package imports matplotlib, and only when a picture is drawn. It uses the
object interface: no global state, and no window unless one is requested.
"""
