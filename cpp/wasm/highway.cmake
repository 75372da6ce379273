# Google Highway for WebAssembly: its headers alone, since one target needs no detection and no library.
# They are found beside those of the system's own processor, and reached by a link, so that no other
# header of that folder comes along.
find_path(GSUT_HIGHWAY_HEADERS hwy/highway.h REQUIRED NO_CMAKE_FIND_ROOT_PATH
  PATHS /usr/include /usr/local/include)
file(MAKE_DIRECTORY ${PROJECT_BINARY_DIR}/headers)
file(CREATE_LINK ${GSUT_HIGHWAY_HEADERS}/hwy ${PROJECT_BINARY_DIR}/headers/hwy SYMBOLIC)
add_library(hwy::hwy INTERFACE IMPORTED)
target_include_directories(hwy::hwy SYSTEM INTERFACE ${PROJECT_BINARY_DIR}/headers)
