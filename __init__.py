"""The extension's door: everything is imported inside the functions, so that importing this file does nothing."""


def register():
    from .rtgi_addon import register as register_addon

    register_addon()


def unregister():
    from .rtgi_addon import unregister as unregister_addon

    unregister_addon()
