-- The part of Wireshark's interface for Lua that dpstack's dissector uses, for a plain Lua interpreter (newer Wiresharks have
-- Lua 5.4). Standard input: a line for each packet, time in ns and octets in hex. Standard output: number, field and value of
-- each field that the dissector adds, separated by tabs. Arguments: the dissector, the description of the interface.

local DISSECTOR, DESCRIPTION = arg[1], arg[2]
local number = 0

local function whole(value)
    assert(math.tointeger(value), "not a whole number: " .. tostring(value))
    return string.format("%d", value)
end

local SHOW = {
    string = function(value)
        assert(type(value) == "string")
        return value
    end,
    bool = function(value)
        assert(type(value) == "boolean")
        return value and "1" or "0"
    end,
    bytes = function(value) return value end,
    double = function(value) return (string.gsub(string.format("%.9f", value), "%.0+$", "")) end,
    relative_time = function(value) return value end,
    framenum = whole, int8 = whole, uint8 = whole, uint16 = whole, uint32 = whole,
}

ProtoField = setmetatable({}, {
    __index = function(_, kind)
        assert(SHOW[kind], kind)
        return function(abbreviation, _, how) return { kind = kind, abbreviation = abbreviation, how = how } end
    end,
})
local function any_name()
    return setmetatable({}, { __index = function(_, name) return name end })
end
base, frametype = any_name(), any_name()
expert = { group = any_name(), severity = any_name() }
ProtoExpert = { new = function(abbreviation) return { expert = abbreviation } end }
Pref = { uint = function(_, value) return value end, bool = function(_, value) return value end, string = function(_, value) return value end }
NSTime = {
    new = function(seconds, ns)
        assert(math.tointeger(seconds) and math.tointeger(ns))
        local sign = (seconds < 0 or ns < 0) and "-" or ""
        return string.format("%s%d.%09d", sign, math.abs(seconds), math.abs(ns))
    end,
}
Field = {
    new = function(name)
        return function()
            if name == "frame.interface_description" then
                return { value = DESCRIPTION }
            end
        end
    end,
}
Struct = { unpack = string.unpack }
local registered
Proto = function(name)
    return { name = name, prefs = {} }
end
Dissector = { get = function() return registered end }
DissectorTable = {
    get = function(name)
        assert(name == "wtap_encap")
        return {
            add = function(_, encapsulation, proto)
                assert(encapsulation == 45 and not registered)
                registered = proto
            end,
        }
    end,
}
wtap_encaps = { USER0 = 45 }
gui_enabled = function() return false end

local Item = {}
Item.__index = Item
function Item:add(what, first, second)
    local kind = type(what) == "table" and what.kind
    if kind then
        local value = second
        if type(first) ~= "table" then
            value = first
        elseif second == nil and kind == "bytes" then
            value = first.octets:gsub(".", function(one) return string.format("%02x", one:byte()) end)
        elseif second == nil then
            value = 0
            for at = 1, #first.octets do
                value = value * 256 + first.octets:byte(at)
            end
        end
        local shown = SHOW[kind](value)
        if what.how == "HEX" then
            shown = string.format(kind == "uint16" and "0x%04x" or "0x%02x", value)
        end
        io.stdout:write(number, "\t", what.abbreviation, "\t", shown, "\n")
    end
    return self
end
function Item:set_generated() return self end
function Item:append_text() return self end
function Item:add_proto_expert_info(one) assert(one.expert) end

local Tvb = {
    __call = function(self, at, size)
        at = at or 0
        size = size or #self.octets - at
        assert(math.tointeger(at) and math.tointeger(size) and at >= 0 and size > 0 and at + size <= #self.octets)
        return { octets = self.octets:sub(at + 1, at + size) }
    end,
}
Tvb.__index = {
    reported_length_remaining = function(self) return #self.octets end,
    captured_len = function(self) return #self.octets end,
    raw = function(self) return self.octets end,
}

dofile(DISSECTOR)
registered.init()
for line in io.stdin:lines() do
    local at, digits = line:match("^(%d+) (%x*)$")
    local octets = digits:gsub("%x%x", function(one) return string.char(tonumber(one, 16)) end)
    number = number + 1
    local pinfo = { number = number, abs_ts = 1790000000.5, rel_ts = tonumber(at) / 1e9, cols = {} }
    local tree = setmetatable({ visible = true }, Item)
    registered.dissector(setmetatable({ octets = octets }, Tvb), pinfo, tree)
    assert(pinfo.cols.protocol == "PROFIBUS" and type(pinfo.cols.info) == "string")
end
