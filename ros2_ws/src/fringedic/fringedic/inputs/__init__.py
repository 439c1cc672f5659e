"""What people give: arguments of public functions, text of YAML files, folders of a user; checked on arrival."""
